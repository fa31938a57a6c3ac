"""The node of ROS 2 on stand-ins of ROS's modules: its parameters, topics and qualities, and what it publishes."""

import importlib
import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from panoloc.ros2.parameters import explained
from tests.ros2.small_world import OPTICAL, TRUTH, answer, camera_info, planar, stamp_of, transform

SENSOR_DATA = "sensor data"


class Message:
    """Any message of ROS: fields come into being when they are asked for."""

    def __init__(self, **fields: Any) -> None:
        vars(self).update(fields)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "encoding":
            raise AttributeError(name)
        vars(self)[name] = Message()
        return vars(self)[name]


def message(name: str) -> type:
    return type(name, (Message,), {})


class Node:
    given: dict[str, Any]

    def __init__(self, name: str) -> None:
        self.name, self.logged = name, list[str]()
        self.subscribed: dict[str, tuple[str, Any, Any]] = {}
        self.published: dict[str, list[Any]] = {}

    def declare_parameter(self, name: str, default: Any, described: Any) -> Any:
        assert described.read_only
        return SimpleNamespace(value=self.given.get(name, default))

    def create_timer(self, period_s: float, callback: Any) -> None:
        self.timers = [(period_s, callback)]

    def create_publisher(self, kind: type, topic: str, quality: Any) -> Any:
        sent = self.published[topic] = []
        return SimpleNamespace(publish=sent.append)

    def create_subscription(self, kind: type, topic: str, callback: Any, quality: Any) -> None:
        self.subscribed[topic] = kind.__name__, callback, quality

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.logged.append, warning=self.logged.append)


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the module of the node."""
    Node.given = {"map": "map_a"}
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {},
        "rclpy.executors": {"ExternalShutdownException": type("ExternalShutdownException", (Exception,), {})},
        "rcl_interfaces": {},
        "rcl_interfaces.msg": {"ParameterDescriptor": lambda **given: SimpleNamespace(**given)},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {
            "qos_profile_sensor_data": SENSOR_DATA,
            "QoSProfile": lambda **given: given,
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="latched"),
        },
        "rclpy.time": {"Time": lambda nanoseconds: SimpleNamespace(to_msg=lambda: stamp_of(nanoseconds / 1e9))},
        "geometry_msgs": {},
        "geometry_msgs.msg": {name: message(name) for name in ("PoseWithCovarianceStamped", "TransformStamped")},
        "sensor_msgs": {},
        "sensor_msgs.msg": {name: message(name) for name in ("CameraInfo", "CompressedImage", "Image")},
        "tf2_msgs": {},
        "tf2_msgs.msg": {"TFMessage": message("TFMessage")},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "panoloc.ros2.node", raising=False)
    yield importlib.import_module("panoloc.ros2.node")
    sys.modules.pop("panoloc.ros2.node", None)


def test_topics_and_qualities_are_those_of_ros(ros: Any) -> None:
    Node.given |= {"image_topic": "/camera/image_raw/compressed", "camera_info_topic": "/camera/camera_info"}
    node = ros.PlaceFinderNode()
    assert {topic: (kind, quality) for topic, (kind, _, quality) in node.subscribed.items()} == {
        "/tf": ("TFMessage", {"depth": 100}),
        "/tf_static": ("TFMessage", {"depth": 100, "durability": "latched"}),
        "/camera/camera_info": ("CameraInfo", SENSOR_DATA),
        "/camera/image_raw/compressed": ("CompressedImage", SENSOR_DATA),
    }
    assert set(node.published) == {"/tf", "~/pose", "initialpose"}
    assert node.name == "panoloc"


def test_without_a_map_the_node_says_what_it_needs(ros: Any) -> None:
    Node.given = {}
    with pytest.raises(ValueError, match="expected the id of a map"):
        ros.PlaceFinderNode()


def test_inputs_that_never_come_are_named(ros: Any) -> None:
    node = ros.PlaceFinderNode()
    ((_, look),) = node.timers
    look(), look()
    (said,) = node.logged
    assert "tf from 'odom' to 'base_link', camera_info;" in said
    receive = {topic: callback for topic, (_, callback, _) in node.subscribed.items()}
    receive["camera_info"](camera_info())
    receive["/tf"](transform(100, "odom", "base_link", planar(0, 0, 0)))
    look()
    assert "nothing came yet: image;" in node.logged[-1]


def test_whole_numbers_of_files_are_taken_for_fractions(ros: Any) -> None:
    Node.given |= {"rate_hz": 20, "period_s": 5}
    assert ros.PlaceFinderNode()._names.rate_hz == 20.0


def test_every_parameter_can_be_set(ros: Any) -> None:
    Node.given = {name: "http://b" if isinstance(default, str) else default for name, default, _ in explained()}
    names = ros.PlaceFinderNode()._names
    assert (names.map, names.url, names.base_frame) == ("http://b",) * 3


def test_an_answer_becomes_a_transform_and_poses(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoloc.ros2.service.localize", lambda *_: answer(TRUTH, warnings=["a warning"]))
    node = ros.PlaceFinderNode()
    receive = {topic: callback for topic, (_, callback, _) in node.subscribed.items()}
    receive["/tf_static"](transform(0, "base_link", "optical", OPTICAL))
    receive["camera_info"](camera_info())
    header = SimpleNamespace(stamp=stamp_of(100.01), frame_id="optical")
    for number in range(100):
        receive["/tf"](transform(100 + number / 50, "odom", "base_link", planar(0, 0, 0)))
        receive["image"](SimpleNamespace(header=header, encoding="mono8", height=1, width=2, step=2, data=b"ab"))
        if node._finder._asking:
            node._finder._asking[1].result(5)
    sent = node.published["/tf"][-1].transforms[0]
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")
    moved, flat = sent.transform, TRUTH.flat
    assert [moved.translation.x, moved.translation.y, moved.translation.z] == pytest.approx(flat.position.tolist())
    turn = [getattr(moved.rotation, axis) for axis in "xyzw"]
    assert turn == pytest.approx(flat.xyzw)
    (initial,) = node.published["initialpose"]
    pose = node.published["~/pose"][-1]
    for each in (initial, pose):
        assert each.header.frame_id == "map"
        assert len(each.pose.covariance) == 36
        assert each.pose.pose.position.x == pytest.approx(flat.position[0])
    assert pose.header.stamp.sec in (101, 102)
    assert "a warning" in node.logged
