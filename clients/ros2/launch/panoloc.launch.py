"""Starts the node: ros2 launch panoloc_ros2 panoloc.launch.py params_file:=… map:=map_…."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PARAMS = str(Path(get_package_share_directory("panoloc_ros2"), "config", "params.yaml"))


def generate_launch_description() -> LaunchDescription:
    """Return the node with its parameters; the id of the map wins over the file."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("map", description="Id of the map to localize in."),
            DeclareLaunchArgument("namespace", default_value="", description="Of the robot, where there are several."),
            DeclareLaunchArgument(
                "params_file", default_value=PARAMS, description="YAML file of the other parameters."
            ),
            Node(
                package="panoloc_ros2",
                executable="panoloc",
                name="panoloc",
                namespace=LaunchConfiguration("namespace"),
                # Each robot has a tree of its own there.
                remappings=[("/tf", "tf"), ("/tf_static", "tf_static")],
                output="screen",
                parameters=[
                    LaunchConfiguration("params_file"),
                    {"map": ParameterValue(LaunchConfiguration("map"), value_type=str)},
                ],
            ),
        ]
    )
