"""The parameters of the node: each once, with its default and what it means."""

from dataclasses import dataclass, field, fields
from typing import Any


def _parameter(default: Any, meaning: str) -> Any:
    return field(default=default, metadata={"meaning": meaning})


@dataclass(frozen=True)
class Parameters:
    """What a user can set, by ROS parameters or by options of `panoloc ros2`."""

    map: str = _parameter("", "id of the map to localize in")
    url: str = _parameter("http://127.0.0.1:8000", "URL of the service")
    image_topic: str = _parameter("image", "images; `…/compressed` for CompressedImage")
    camera_info_topic: str = _parameter("camera_info", "their intrinsics")
    rectified: bool = _parameter(False, "the images are rectified: use `p` of camera_info, without distortion")
    camera_frame: str = _parameter("", "optical frame of the images, where their `frame_id` is wrong")
    map_frame: str = _parameter("map", "frame of the scan")
    odom_frame: str = _parameter("odom", "frame of the odometry")
    base_frame: str = _parameter("base_link", "frame of the robot")
    publish_tf: bool = _parameter(True, "publish `map` → `odom`; off where AMCL or slam_toolbox does")
    planar: bool = _parameter(True, "publish x, y and yaw alone, at z = 0, as Nav2 expects; off for drones and stairs")
    rate_hz: float = _parameter(20.0, "how often a second `map` → `odom` and `~/pose` are published, at most")
    tf_tolerance_s: float = _parameter(0.2, "how far `map` → `odom` is dated ahead, so that it is there when needed")
    period_s: float = _parameter(10.0, "ask again after so long")
    distance_m: float = _parameter(1.0, "ask again after so long a way, or a turn by 90 degrees")
    max_std_m: float = _parameter(0.2, "ask again once the position is so uncertain")
    odometry_drift: float = _parameter(0.05, "expected error of the odometry, as a share of the way")
    min_confidence: float = _parameter(0.95, "confidence from which one answer is enough at first; else two that agree")

    def __post_init__(self) -> None:
        """Raise ValueError for values that cannot be meant."""
        if not self.map:
            raise ValueError("map: expected the id of a map, got none; `panoloc maps` lists them")
        if not self.url.startswith(("http://", "https://")):
            raise ValueError(f"url: expected an address such as http://127.0.0.1:8000, got {self.url!r}")
        for name in ("rate_hz", "period_s", "distance_m", "max_std_m", "odometry_drift"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name):g}")
        if not 0 <= self.min_confidence <= 1:
            raise ValueError(f"min_confidence: expected 0 to 1, got {self.min_confidence:g}")


def explained() -> list[tuple[str, Any, str]]:
    """Return name, default and meaning of every parameter."""
    return [(each.name, each.default, each.metadata["meaning"]) for each in fields(Parameters)]
