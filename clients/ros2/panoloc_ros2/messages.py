"""The ROS messages in use, as DDS types of cyclonedds: names, order of fields and bytes as ROS has them."""

from typing import Any

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32


def _message(name: str, **fields: Any) -> Any:
    """Return a dataclass for a message such as std_msgs/Header."""
    package, kind = name.split("/")
    return final(make_idl_struct(kind, f"{package}::msg::dds_::{kind}_", fields))


Time = _message("builtin_interfaces/Time", sec=int32, nanosec=uint32)
Header = _message("std_msgs/Header", stamp=Time, frame_id=str)

Point = _message("geometry_msgs/Point", x=float64, y=float64, z=float64)
Vector3 = _message("geometry_msgs/Vector3", x=float64, y=float64, z=float64)
Quaternion = _message("geometry_msgs/Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = _message("geometry_msgs/Pose", position=Point, orientation=Quaternion)
PoseWithCovariance = _message("geometry_msgs/PoseWithCovariance", pose=Pose, covariance=array[float64, 36])
PoseWithCovarianceStamped = _message("geometry_msgs/PoseWithCovarianceStamped", header=Header, pose=PoseWithCovariance)
Transform = _message("geometry_msgs/Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = _message("geometry_msgs/TransformStamped", header=Header, child_frame_id=str, transform=Transform)
TFMessage = _message("tf2_msgs/TFMessage", transforms=sequence[TransformStamped])

RegionOfInterest = _message(
    "sensor_msgs/RegionOfInterest", x_offset=uint32, y_offset=uint32, height=uint32, width=uint32, do_rectify=bool
)
CameraInfo = _message(
    "sensor_msgs/CameraInfo",
    header=Header,
    height=uint32,
    width=uint32,
    distortion_model=str,
    d=sequence[float64],
    k=array[float64, 9],
    r=array[float64, 9],
    p=array[float64, 12],
    binning_x=uint32,
    binning_y=uint32,
    roi=RegionOfInterest,
)
Image = _message(
    "sensor_msgs/Image",
    header=Header,
    height=uint32,
    width=uint32,
    encoding=str,
    is_bigendian=uint8,
    step=uint32,
    data=sequence[uint8],
)
CompressedImage = _message("sensor_msgs/CompressedImage", header=Header, format=str, data=sequence[uint8])
