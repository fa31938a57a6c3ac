"""The transport of ROS 2: `ros2 launch panoloc_ros2 panoloc.launch.py`."""

import sys
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_msgs.msg import TFMessage

from .estimate import Spread
from .parameters import Parameters, explained
from .place_finder import PlaceFinder
from .poses import Pose

_LOOK_EVERY_S = 5.0


class PlaceFinderNode(Node):  # type: ignore[misc]  # of a module that is not there
    """Hands messages to the place finder and publishes what it finds."""

    def __init__(self) -> None:
        """Read the parameters. Raises ValueError for those that cannot be meant."""
        super().__init__("panoloc")
        self._names = names = Parameters(**{each[0]: self._declared(*each) for each in explained()})
        reliable = QoSProfile(depth=100)
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._tf = self.create_publisher(TFMessage, "/tf", reliable)
        self._pose = self.create_publisher(PoseWithCovarianceStamped, "~/pose", 10)
        self._initial = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        self._finder = finder = PlaceFinder(names, self)
        images = CompressedImage if names.image_topic.endswith("compressed") else Image
        self.create_subscription(
            TFMessage, "/tf_static", lambda message: finder.on_tf(message, is_static=True), latched
        )
        self.create_subscription(TFMessage, "/tf", finder.on_tf, reliable)
        self.create_subscription(CameraInfo, names.camera_info_topic, finder.on_camera_info, qos_profile_sensor_data)
        self.create_subscription(images, names.image_topic, finder.on_image, qos_profile_sensor_data)
        self.create_timer(_LOOK_EVERY_S, finder.say_what_is_missing)

    def _declared(self, name: str, default: Any, meaning: str) -> Any:
        """Return a parameter. In files 20 is a whole number, also of what has fractions."""
        described = ParameterDescriptor(description=meaning, read_only=True, dynamic_typing=True)
        return type(default)(self.declare_parameter(name, default, described).value)

    def send_transform(self, stamp: float, map_from_odom: Pose) -> None:
        """Publish on /tf."""
        message = TransformStamped()
        self._head(message, stamp)
        message.child_frame_id = self._names.odom_frame
        _fill(message.transform.translation, message.transform.rotation, map_from_odom)
        self._tf.publish(TFMessage(transforms=[message]))

    def send_pose(self, stamp: float, map_from_base: Pose, spread: Spread, is_initial: bool) -> None:
        """Publish on /initialpose or ~/pose."""
        message = PoseWithCovarianceStamped()
        self._head(message, stamp)
        _fill(message.pose.pose.position, message.pose.pose.orientation, map_from_base)
        message.pose.covariance = spread.covariance
        (self._initial if is_initial else self._pose).publish(message)

    def info(self, text: str) -> None:
        """Log."""
        self.get_logger().info(text)

    def warning(self, text: str) -> None:
        """Log."""
        self.get_logger().warning(text)

    def _head(self, message: Any, stamp: float) -> None:
        message.header.stamp = Time(nanoseconds=round(stamp * 1e9)).to_msg()
        message.header.frame_id = self._names.map_frame


def _fill(position: Any, orientation: Any, pose: Pose) -> None:
    position.x, position.y, position.z = pose.position.tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = pose.xyzw


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    try:
        rclpy.spin(PlaceFinderNode())
    except ValueError as error:
        sys.exit(f"{error}; parameters are set by --ros-args -p map:=map_…")
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
