"""Brings up tactile_sim, and on request the player of presses and the recorder.

ros2 launch dotsim_ros tactile_sim.launch.py params_file:=MINE.yaml namespace:=left play:=true
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    namespace = LaunchConfiguration("namespace")
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(params / "tactile_sim.yaml"),
                description="parameters of tactile_sim",
            ),
            DeclareLaunchArgument("play", default_value="false", description="replay presses"),
            DeclareLaunchArgument("record", default_value="false", description="record a bag"),
            Node(
                package="dotsim_ros",
                executable="tactile_sim",
                namespace=namespace,
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="indenter_player",
                namespace=namespace,
                condition=IfCondition(LaunchConfiguration("play")),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_record",
                namespace=namespace,
                condition=IfCondition(LaunchConfiguration("record")),
                output="screen",
            ),
        ]
    )
