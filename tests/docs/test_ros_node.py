"""The node of docs/ar/ros2.py on stand-ins of ROS's modules: it waits for nothing in a callback, and outlives a busy service."""

import sys
import time
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tests.docs.documentation import ROOT
from tests.integration.running_service import eventually

SENSOR_DATA = object()
FOUND = {"position_m": {"x": 1.0, "y": 2.0, "z": 3.0}, "quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
ANSWER = {"status": "localized", "map_from_session": FOUND, "warnings": ["one"]}
BUSY = SimpleNamespace(status_code=429, headers={"Retry-After": "0"}, json=lambda: {"detail": "busy"})


class Node:
    def __init__(self, name: str) -> None:
        self.logged: list[str] = []
        self.qualities: list[object] = []
        self.timers: list[Any] = []

    def create_subscription(self, kind: object, topic: str, callback: object, quality: object) -> None:
        self.qualities.append(quality)

    def create_timer(self, period_s: float, callback: object) -> None:
        self.timers.append(callback)

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.logged.append, error=self.logged.append)


class Service:
    """Answers by turns what it is given. takes_s: how long each time."""

    def __init__(self, *replies: Any, takes_s: float = 0.0) -> None:
        self._replies, self._takes_s = list(replies), takes_s
        self.requests: list[dict[str, Any]] = []

    def post(self, url: str, **request: Any) -> Any:
        self.requests.append(request)
        time.sleep(self._takes_s)
        reply = self._replies.pop(0)
        if isinstance(reply, Exception):
            raise reply
        return reply


def answered(answer: dict[str, Any]) -> SimpleNamespace:
    return SimpleNamespace(status_code=200, headers={}, json=lambda: answer)


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return what the file defines; `sent`: the transforms that its broadcaster was given."""
    sent: list[Any] = []
    broadcaster = SimpleNamespace(sendTransform=sent.append)
    message = SimpleNamespace(transform=SimpleNamespace(translation=SimpleNamespace(), rotation=SimpleNamespace()))
    message.header = SimpleNamespace()
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": SENSOR_DATA},
        "rclpy.time": {"Time": SimpleNamespace(from_msg=lambda stamp: stamp)},
        "requests": {"ConnectionError": ConnectionError},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"TransformStamped": lambda: message},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"CameraInfo": None, "CompressedImage": None},
        "tf2_ros": {
            "Buffer": SimpleNamespace,
            "StaticTransformBroadcaster": lambda node: broadcaster,
            "TransformException": LookupError,
            "TransformListener": lambda buffer, node: None,
        },
    }
    for name, members in modules.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    names: dict[str, Any] = {"sent": sent}
    exec(compile((ROOT / "docs" / "ar" / "ros2.py").read_text(), "docs/ar/ros2.py", "exec"), names)
    names["time"] = SimpleNamespace(monotonic=time.monotonic, sleep=lambda seconds: None)
    return names


def asked(ros: dict[str, Any], service: Service) -> Any:
    """Return a node that has just sent six frames to a service."""
    ros["requests"].post = service.post
    node = ros["PlaceFinder"]("http://service", "map_a")
    node.info = SimpleNamespace(
        distortion_model="plumb_bob", width=640, height=480, k=[500.0, 0, 320, 0, 500, 240], d=[0.0] * 5
    )
    for number in range(6):
        node.turns = []  # each shows a new direction
        node.image = SimpleNamespace(data=b"jpeg", header=SimpleNamespace(frame_id="optical", stamp=number))
        turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        found = SimpleNamespace(translation=SimpleNamespace(x=0.0, y=0.0, z=0.0), rotation=turn)
        node.buffer.lookup_transform = lambda *_, found=found: SimpleNamespace(transform=found)
        node.timers[0]()
    return node


def test_it_takes_what_drivers_send_without_receipts(ros: dict[str, Any]) -> None:
    assert ros["PlaceFinder"]("http://service", "map_a").qualities == [SENSOR_DATA] * 2


def test_an_answer_is_published_without_a_callback_that_waits_for_it(ros: dict[str, Any]) -> None:
    began = time.monotonic()
    node = asked(ros, Service(answered(ANSWER), takes_s=0.3))
    node.timers[0]()
    assert time.monotonic() - began < 0.2
    assert not ros["sent"]
    assert eventually(lambda: bool(node.timers[0]() or ros["sent"]), 10)
    assert vars(ros["sent"][0].transform.translation) == FOUND["position_m"]
    assert (node.logged, node.asked) == (["one"], None)


def test_a_busy_service_is_asked_again_and_one_that_fails_ends_nothing(ros: dict[str, Any]) -> None:
    service = Service(BUSY, ConnectionError("away"), answered(ANSWER))
    node = asked(ros, service)
    assert eventually(lambda: bool(node.timers[0]() or ros["sent"]), 10)
    assert len({request["headers"]["Idempotency-Key"] for request in service.requests}) == 1
    node = asked(ros, Service(SimpleNamespace(status_code=500, headers={}, json=lambda: {"detail": "broken"})))
    assert eventually(lambda: bool(node.timers[0]() or node.logged), 10)
    assert (node.logged, node.asked) == (["no answer: broken"], None)
    node = asked(ros, Service(answered({**ANSWER, "status": "ambiguous"})))
    assert eventually(lambda: bool(node.timers[0]() or node.logged), 10)
    assert len(ros["sent"]) == 1
