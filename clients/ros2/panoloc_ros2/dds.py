"""The transport without ROS: topics of ROS 2 over DDS, by cyclonedds."""

import logging
import os
import re
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from . import messages
from .estimate import Spread
from .parameters import Parameters
from .place_finder import PlaceFinder
from .poses import Pose

NODE = "panoloc"
_MOST_DOMAIN_ID = 232
_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
_LOOK_EVERY_S = 5.0
_log = logging.getLogger(NODE)


def _quality(reliability: Any, depth: int, *others: Any) -> Qos:
    # ROS writes the first version of CDR.
    plain = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
    return Qos(reliability, Policy.History.KeepLast(depth), plain, *others)


_RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
SENSOR_DATA = _quality(Policy.Reliability.BestEffort, 1)
RELIABLE = _quality(_RELIABLE, 100)
LATCHED = _quality(_RELIABLE, 100, Policy.Durability.TransientLocal)


def participant() -> DomainParticipant:
    """Join the domain that ROS_DOMAIN_ID names. Raises ValueError."""
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (given.isdecimal() and int(given) <= _MOST_DOMAIN_ID):
        raise ValueError(f"ROS_DOMAIN_ID: expected 0 to {_MOST_DOMAIN_ID}, got {given!r}")
    return DomainParticipant(int(given))


def topic(domain: DomainParticipant, name: str, kind: type[Any]) -> "Topic[Any]":
    """Return the DDS topic of a topic of ROS. Raises ValueError for what is no name of one."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"expected the name of a topic, such as /camera/image_raw, got {name!r}")
    return Topic(domain, f"rt/{name.lstrip('/')}", kind)


def time_message(stamp: float) -> Any:
    """Return seconds as a ROS time."""
    nanoseconds = round(stamp * 1e9)
    return messages.Time(nanoseconds // 10**9, nanoseconds % 10**9)


class DdsNode:
    """The node: `run` reads until it is stopped."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters, self._domain = parameters, participant()
        self._finder = PlaceFinder(parameters, self)
        self._waiting = WaitSet(self._domain)
        self._tf = self._writer("tf", messages.TFMessage)
        self._pose = self._writer(f"{NODE}/pose", messages.PoseWithCovarianceStamped)
        self._initial = self._writer("initialpose", messages.PoseWithCovarianceStamped)
        images = messages.CompressedImage if parameters.image_topic.endswith("compressed") else messages.Image
        tf = messages.TFMessage
        self._readers: list[tuple[DataReader[Any], Callable[[Any], None]]] = [
            (self._reader("tf_static", tf, LATCHED), lambda message: self._finder.on_tf(message, is_static=True)),
            (self._reader(parameters.camera_info_topic, messages.CameraInfo, SENSOR_DATA), self._finder.on_camera_info),
            (self._reader("tf", tf, RELIABLE), self._finder.on_tf),
        ]
        self._images = self._reader(parameters.image_topic, images, SENSOR_DATA)
        # Whatever happens, happens when odometry comes.
        state = SampleState.Any | ViewState.Any | InstanceState.Any
        self._waiting.attach(ReadCondition(self._readers[-1][0], state))

    def run(self, is_stopped: Callable[[], bool] = lambda: False) -> None:
        """Hand messages to the place finder."""
        looked = time.monotonic()
        while not is_stopped():
            if time.monotonic() - looked > _LOOK_EVERY_S:
                looked = time.monotonic()
                self._finder.say_what_is_missing()
            self._waiting.wait(duration(milliseconds=200))
            # To read an image takes time: one that is not looked at stays unread until the next takes its place.
            taken = [(self._images, self._finder.on_image)] if self._finder.wants_image else []
            for reader, receive in (*taken, *self._readers):
                for message in reader.take(100):
                    if isinstance(message, reader.topic.data_type):  # others say that a writer is gone
                        receive(message)

    def send_transform(self, stamp: float, map_from_odom: Pose) -> None:
        """Publish on /tf."""
        names, translation = self._parameters, messages.Vector3(*map_from_odom.position.tolist())
        moved = messages.Transform(translation, messages.Quaternion(*map_from_odom.xyzw))
        header = messages.Header(time_message(stamp), names.map_frame)
        self._tf.write(messages.TFMessage([messages.TransformStamped(header, names.odom_frame, moved)]))

    def send_pose(self, stamp: float, map_from_base: Pose, spread: Spread, is_initial: bool) -> None:
        """Publish on /initialpose or /panoloc/pose."""
        position, turn = messages.Point(*map_from_base.position.tolist()), messages.Quaternion(*map_from_base.xyzw)
        header = messages.Header(time_message(stamp), self._parameters.map_frame)
        found = messages.PoseWithCovariance(messages.Pose(position, turn), spread.covariance)
        (self._initial if is_initial else self._pose).write(messages.PoseWithCovarianceStamped(header, found))

    def info(self, text: str) -> None:
        """Log."""
        _log.info(text)

    def warning(self, text: str) -> None:
        """Log."""
        _log.warning(text)

    def _writer(self, name: str, kind: type[Any]) -> "DataWriter[Any]":
        return DataWriter(self._domain, topic(self._domain, name, kind), qos=RELIABLE)

    def _reader(self, name: str, kind: type[Any], quality: Qos) -> "DataReader[Any]":
        return DataReader(self._domain, topic(self._domain, name, kind), qos=quality)
