"""Collects frames of a ROS 2 camera, localizes them with panoloc and publishes `map` to `odom`: docs/ar.md."""

import json
import time
import uuid
from concurrent.futures import ThreadPoolExecutor

import rclpy
import requests
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage
from tf2_ros import Buffer, StaticTransformBroadcaster, TransformException, TransformListener

MODELS = {"plumb_bob": "opencv", "rational_polynomial": "opencv", "equidistant": "opencv_fisheye"}


def entry(info, odom_from_optical):
    """Return what describes an image: its CameraInfo and the tf of its optical frame."""
    t, q = odom_from_optical.translation, odom_from_optical.rotation
    return {
        "model": MODELS[info.distortion_model],
        "width_px": info.width,
        "height_px": info.height,
        "fx_px": info.k[0],
        "fy_px": info.k[4],
        "cx_px": info.k[2] + 0.5,
        "cy_px": info.k[5] + 0.5,
        "distortion": list(info.d),
        "session_from_camera": {
            "position_m": {"x": t.x, "y": t.y, "z": t.z},
            "quaternion": {"x": q.x, "y": q.y, "z": q.z, "w": q.w},
        },
    }


def localize(service, map_id, shots):
    """Return the answer. Where the service is busy or away, ask again for half a minute."""
    options = {"frame": "opencv", "cameras": [camera for _, camera in shots], "session": {"up": "known"}}
    images = [("image", (f"{number}.jpg", jpeg, "image/jpeg")) for number, (jpeg, _) in enumerate(shots)]
    form = {"map_id": map_id, "options": json.dumps(options)}
    until = time.monotonic() + 30
    once = {"Idempotency-Key": str(uuid.uuid4())}  # asked again after a lost answer, it is not searched again
    while True:
        try:
            reply = requests.post(f"{service}/localize", files=images, data=form, headers=once, timeout=90)
        except requests.ConnectionError:
            if time.monotonic() > until:
                raise
            time.sleep(2)
            continue
        if reply.status_code not in (409, 429, 503) or time.monotonic() > until:
            break
        time.sleep(float(reply.headers.get("Retry-After", 2)))
    if reply.status_code != 200:
        raise RuntimeError(reply.json()["detail"])
    return reply.json()


def map_from_odom(found, stamp):
    """Return the tf message of an answer's `map_from_session`."""
    message = TransformStamped()
    message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "map", "odom"
    for part, values in (
        (message.transform.translation, found["position_m"]),
        (message.transform.rotation, found["quaternion"]),
    ):
        for axis, value in values.items():
            setattr(part, axis, value)
    return message


class PlaceFinder(Node):
    """Let the robot turn around: takes a frame every second, turned by 30 degrees or more from every other."""

    def __init__(self, service, map_id):
        super().__init__("place_finder")
        self.service, self.map_id, self.shots, self.turns = service, map_id, [], []
        self.info = self.image = self.asked = None
        self.asking = ThreadPoolExecutor(1)  # an answer takes longer than callbacks may
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        self.broadcaster = StaticTransformBroadcaster(self)
        self.create_subscription(CameraInfo, "camera_info", self.on_info, qos_profile_sensor_data)
        self.create_subscription(CompressedImage, "image_raw/compressed", self.on_image, qos_profile_sensor_data)
        self.create_timer(1.0, self.on_timer)

    def on_info(self, message):
        """Keep the intrinsics."""
        self.info = message

    def on_image(self, message):
        """Keep an image until the timer fires."""
        self.image = self.image or message  # waits for the timer: by then the tf of its moment is there

    def on_timer(self):
        """Take the frame if it shows a new direction; localize after six."""
        image, self.image = self.image, None
        if self.asked is not None:
            self.take_answer()
            return
        if image is None or self.info is None:
            return
        try:
            found = self.buffer.lookup_transform("odom", image.header.frame_id, Time.from_msg(image.header.stamp))
        except TransformException:
            return
        q = found.transform.rotation
        turn = (q.x, q.y, q.z, q.w)
        # cos(30° / 2) = 0.966
        if any(abs(sum(a * b for a, b in zip(turn, other, strict=True))) > 0.966 for other in self.turns):
            return
        self.turns.append(turn)
        self.shots.append((bytes(image.data), entry(self.info, found.transform)))
        if len(self.shots) == 6:
            self.asked = self.asking.submit(localize, self.service, self.map_id, self.shots)
            self.stamp, self.shots, self.turns = image.header.stamp, [], []

    def take_answer(self):
        """Publish the answer once it is there; where there is none, say why and collect new frames."""
        if not self.asked.done():
            return
        asked, self.asked = self.asked, None
        if asked.exception() is not None:
            self.get_logger().error(f"no answer: {asked.exception()}")
            return
        answer = asked.result()
        for warning in answer["warnings"]:
            self.get_logger().warning(warning)
        if answer["status"] == "localized":
            self.broadcaster.sendTransform(map_from_odom(answer["map_from_session"], self.stamp))


def main():
    """Run the node."""
    rclpy.init()
    rclpy.spin(PlaceFinder("http://127.0.0.1:8000", "map_…"))
