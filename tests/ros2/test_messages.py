"""What goes over DDS is what ROS 2 writes and reads: bytes against those of rosbags, names and qualities of the topics."""

import time
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from panoloc.ros2 import dds, messages
from panoloc.ros2.parameters import Parameters
from panoloc.ros2.poses import Pose

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

STORE = get_typestore(Stores.ROS2_HUMBLE)
HEADER = messages.Header(messages.Time(1_700_000_000, 999_999_999), "camera_optical_frame")
TRANSFORM = messages.Transform(messages.Vector3(1.0, -2.0, 0.5), messages.Quaternion(0.0, 0.6, 0.0, 0.8))
POSE = messages.Pose(messages.Point(1.0, -2.0, 0.5), messages.Quaternion(0.0, 0.6, 0.0, 0.8))
NUMBERS = np.random.default_rng(1).normal(size=64).tolist()
MESSAGES = {
    "sensor_msgs/msg/Image": messages.Image(HEADER, 2, 3, "rgb8", 0, 9, list(range(18))),
    "sensor_msgs/msg/CompressedImage": messages.CompressedImage(HEADER, "rgb8; jpeg compressed bgr8", [255, 216, 0]),
    "sensor_msgs/msg/CameraInfo": messages.CameraInfo(
        HEADER, 480, 640, "rational_polynomial", NUMBERS[:8], NUMBERS[:9], NUMBERS[9:18], NUMBERS[18:30], 2, 1,
        messages.RegionOfInterest(1, 2, 3, 4, True),
    ),
    "tf2_msgs/msg/TFMessage": messages.TFMessage(
        [messages.TransformStamped(HEADER, name, TRANSFORM) for name in ("base_link", "odd name", "ä")]
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": messages.PoseWithCovarianceStamped(
        HEADER, messages.PoseWithCovariance(POSE, NUMBERS[:36])
    ),
}  # fmt: skip


def plain(message: Any) -> Any:
    """Return a message of either library as dictionaries and lists."""
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list | tuple):
        return [plain(each) for each in message]
    if hasattr(message, "__dataclass_fields__"):
        return {name: plain(getattr(message, name)) for name in message.__dataclass_fields__ if name != "__msgtype__"}
    return message


@pytest.mark.parametrize("name", MESSAGES)
def test_bytes_are_those_of_ros(name: str) -> None:
    message = MESSAGES[name]
    # DDS pads to four bytes.
    written = message.serialize(use_version_2=False)
    read = STORE.deserialize_cdr(written, name)
    assert plain(read) == plain(message)
    of_ros = bytes(STORE.serialize_cdr(read, name))
    assert of_ros.ljust(len(written), b"\0") == written
    assert plain(type(message).deserialize(of_ros)) == plain(message)


def test_topics_have_names_types_and_qualities_of_ros(dds_network: None) -> None:
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
    from cyclonedds.qos import Policy

    domain = dds.participant()
    node = dds.DdsNode(Parameters(map="map_a", image_topic="/camera/image_raw/compressed"))
    found: dict[tuple[str, str], Any] = {}
    until = time.monotonic() + 10
    kinds = {"writes": BuiltinTopicDcpsPublication, "reads": BuiltinTopicDcpsSubscription}
    readers = {word: BuiltinDataReader(domain, kind) for word, kind in kinds.items()}
    while len(found) < 7 and time.monotonic() < until:
        time.sleep(0.02)
        seen = [(word, each) for word, reader in readers.items() for each in reader.take(20)]
        found |= {(word, each.topic_name): each for word, each in seen if each.topic_name.startswith("rt/")}
    node.send_transform(1.0, Pose(np.eye(3), np.zeros(3)))
    pose, tf = "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_", "tf2_msgs::msg::dds_::TFMessage_"
    assert {key: each.type_name for key, each in found.items()} == {
        ("writes", "rt/tf"): tf,
        ("writes", "rt/panoloc/pose"): pose,
        ("writes", "rt/initialpose"): pose,
        ("reads", "rt/tf"): tf,
        ("reads", "rt/tf_static"): tf,
        ("reads", "rt/camera_info"): "sensor_msgs::msg::dds_::CameraInfo_",
        ("reads", "rt/camera/image_raw/compressed"): "sensor_msgs::msg::dds_::CompressedImage_",
    }
    for (_, name), each in found.items():
        is_sensor = "camera" in name
        assert (Policy.Reliability.BestEffort in each.qos) == is_sensor, name
        assert (Policy.Durability.TransientLocal in each.qos) == (name == "rt/tf_static"), name
        # The first version of CDR, the only one that ROS knows.
        plain_cdr = each.qos[Policy.DataRepresentation]
        assert (plain_cdr.use_cdrv0_representation, plain_cdr.use_xcdrv2_representation) == (True, False)
