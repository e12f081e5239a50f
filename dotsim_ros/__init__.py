"""Simulation of soft optical tactile sensors: gel, camera, and the ROS 2 nodes around them.

Importing this package loads neither Warp nor torch nor rclpy; import the submodule that you need.
"""

__version__ = "0.1.0"
