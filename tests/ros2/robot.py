"""The robot as a process: `python -m tests.ros2.robot DRIVE HEARD SPEED` plays a drive over DDS and keeps what it hears of its place.

SPEED: seconds of the drive in one second. Stamps are those of the drive; it begins at START_S.
"""

import pickle
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from panoloc.ros2 import dds, messages
from panoloc.ros2.poses import Pose, pose_of
from tests.ros2.drive import BASE_FROM_OPTICAL, STEP_S, Drive, motion

START_S = 1000.0


def transform(stamp: float, parent: str, child: str, pose: Pose) -> Any:
    """Return a TFMessage of one transform."""
    moved = messages.Transform(messages.Vector3(*pose.position.tolist()), messages.Quaternion(*pose.xyzw))
    header = messages.Header(dds.time_message(stamp), parent)
    return messages.TFMessage([messages.TransformStamped(header, child, moved)])


def camera_info(drive: Drive) -> Any:
    """Return the CameraInfo of a pinhole."""
    lens = drive.camera
    k = [lens.fx_px, 0.0, lens.cx_px - 0.5, 0.0, lens.fy_px, lens.cy_px - 0.5, 0.0, 0.0, 1.0]
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    header, roi = (
        messages.Header(dds.time_message(START_S), "camera_optical"),
        messages.RegionOfInterest(0, 0, 0, 0, False),
    )
    return messages.CameraInfo(
        header, lens.height_px, lens.width_px, "plumb_bob", [0.0] * 5, k, [0.0] * 9, p, 0, 0, roi
    )


def image(drive: Drive, number: int) -> Any:
    """Return the Image of a step."""
    pixels = drive.images[number]
    height, width, _ = pixels.shape
    header = messages.Header(dds.time_message(START_S + number * STEP_S), "camera_optical")
    return messages.Image(header, height, width, "rgb8", 0, 3 * width, list(pixels.tobytes()))


class Robot:
    """Its driver of wheels and camera, and what it heard: (time, map_from_odom), and /initialpose."""

    def __init__(self, drive: Drive) -> None:
        self._drive, domain = drive, dds.participant()

        def writer(name: str, kind: type[Any], quality: Any) -> Any:
            return DataWriter(domain, dds.topic(domain, name, kind), qos=quality)

        def reader(name: str, kind: type[Any], quality: Any) -> Any:
            return DataReader(domain, dds.topic(domain, name, kind), qos=quality)

        self._static = writer("tf_static", messages.TFMessage, dds.LATCHED)
        self._info = writer("camera_info", messages.CameraInfo, dds.RELIABLE)
        self._tf = writer("tf", messages.TFMessage, dds.RELIABLE)
        self._images = writer("image", messages.Image, dds.RELIABLE)
        self._heard_tf = reader("tf", messages.TFMessage, dds.RELIABLE)
        self._heard_poses = reader("panoloc/pose", messages.PoseWithCovarianceStamped, dds.RELIABLE)
        self._heard_initial = reader("initialpose", messages.PoseWithCovarianceStamped, dds.RELIABLE)
        self._static.write(transform(START_S, "base_link", "camera_optical", BASE_FROM_OPTICAL))

    def wait_for_node(self) -> None:
        """Return once somebody reads images."""
        while not self._images.get_matched_subscriptions():
            time.sleep(0.05)
        time.sleep(0.5)  # for the other topics

    def play(self, speed: float) -> dict[str, Any]:
        """Drive, and return what was heard: by steps map_from_odom as (4, 4) or None; covariances; the times of /initialpose."""
        began, known = time.monotonic(), None
        heard: dict[str, Any] = {"map_from_odom": [], "std_m": [], "initial": [], "z": []}
        std_m = np.nan
        for number, place in enumerate(self._drive.odometry):
            time.sleep(max(0.0, began + number * STEP_S / speed - time.monotonic()))
            stamp = START_S + number * STEP_S
            if number % round(1 / STEP_S) == 0:
                self._info.write(camera_info(self._drive))
            if number in self._drive.images:
                self._images.write(image(self._drive, number))
            self._tf.write(transform(stamp, "odom", "base_link", motion(place)))
            for message in self._heard_tf.take(100):
                each = message.transforms[0]
                if each.child_frame_id == "odom":
                    known = pose_of(each.transform.translation, each.transform.rotation)
            for message in self._heard_poses.take(100):
                std_m = message.pose.covariance[0] ** 0.5
            heard["initial"] += [number] * len(self._heard_initial.take(100))
            heard["map_from_odom"].append(known)
            heard["std_m"].append(std_m)
        return heard


def main(drive: str, heard: str, speed: str) -> None:
    """Play a drive and write what was heard."""
    robot = Robot(pickle.loads(Path(drive).read_bytes()))
    robot.wait_for_node()
    Path(heard).write_bytes(pickle.dumps(robot.play(float(speed))))


if __name__ == "__main__":
    main(*sys.argv[1:])
