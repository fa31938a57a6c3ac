"""The last seconds of /tf and all of /tf_static: which frame was where at a time.

Both transports use it, in place of tf2's buffer: its time is that of the stamps alone, with or without /clock.
"""

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from .poses import Pose, is_motion, pose_of

KEPT_S = 10.0
_BACK_IN_TIME_S = 1.0  # less is the disorder of several publishers


def seconds(stamp: Any) -> float:
    """Return a ROS time as seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


@dataclass
class _Edge:
    """parent_from_child over time; of /tf_static it holds at any time."""

    parent: str
    is_static: bool
    times: deque[tuple[float, Pose]] = field(default_factory=deque)

    def at(self, stamp: float) -> Pose | None:
        if self.is_static:
            return self.times[-1][1]
        for (after, second), (before, first) in pairwise(reversed(self.times)):
            if before <= stamp <= after:
                share = (stamp - before) / (after - before)
                return first.moved_towards(second, share, share)
        return self.times[-1][1] if self.times[-1][0] == stamp else None


class Transforms:
    """The tree below one frame, `root`. What lies above, such as `map`, may come from several nodes that date it differently."""

    def __init__(self, root: str) -> None:
        self._root = root
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Any, is_static: bool) -> bool:
        """Add a TFMessage. Return False where its time lies before what is known: all else is forgotten then."""
        goes_on = True
        for each in message.transforms:
            parent, stamp = each.header.frame_id.lstrip("/"), seconds(each.header.stamp)
            child = each.child_frame_id.lstrip("/")
            if child == self._root or not is_motion(each.transform):
                continue
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent or edge.is_static != is_static:
                edge = self._edges[child] = _Edge(parent, is_static)
            if not is_static and edge.times and stamp <= edge.times[-1][0]:
                if stamp > edge.times[-1][0] - _BACK_IN_TIME_S:
                    continue
                goes_on = False
                self._edges = {name: other for name, other in self._edges.items() if other.is_static}
                edge = self._edges[child] = _Edge(parent, is_static)
            edge.times.append((stamp, pose_of(each.transform.translation, each.transform.rotation)))
            while (is_static and len(edge.times) > 1) or edge.times[0][0] < stamp - KEPT_S:
                edge.times.popleft()
        return goes_on

    def at(self, source: str, stamp: float) -> Pose | None:
        """Return root_from_source, None where that is not known at that time (yet)."""
        edges = self._up(source)
        pose: Pose | None = None
        for edge in edges or ():
            step = edge.at(stamp)
            if step is None:
                return None
            pose = step if pose is None else step @ pose
        return pose

    def latest(self, source: str) -> tuple[float, Pose] | None:
        """Return the last time at which all is known, and root_from_source then."""
        stamps = [edge.times[-1][0] for edge in self._up(source) or () if not edge.is_static]
        pose = self.at(source, min(stamps)) if stamps else None
        return None if pose is None else (min(stamps), pose)

    def _up(self, source: str) -> list[_Edge] | None:
        edges: list[_Edge] = []
        while source != self._root:
            edge = self._edges.get(source)
            if edge is None or len(edges) == len(self._edges):  # the latter: a ring
                return None
            edges.append(edge)
            source = edge.parent
        return edges
