"""One press with the installed library, in a venv that knows no ROS."""

import sys

import numpy as np

import dotsim_ros

heavy = {"warp", "torch", "rclpy"} & set(sys.modules)
assert not heavy, f"importing dotsim_ros loaded {heavy}"

from dotsim_ros.geometry.indenter import load_indenter  # noqa: E402
from dotsim_ros.geometry.pose import Pose  # noqa: E402
from dotsim_ros.sensor import TactileSensor  # noqa: E402
from dotsim_ros.specification import load_sensor  # noqa: E402

sensor = TactileSensor(load_sensor("densetact2"), indenter=load_indenter("sphere_4mm"))
apex_m = float(sensor.skin.rest_position_m[:, 2].max())
frame = sensor.step(Pose(np.array([0.0, 0.0, apex_m - 0.001])), 0.04)
assert frame.image.shape == (480, 640, 3), frame.image.shape
assert frame.wrench.force_n[2] > 0.0, frame.wrench
assert "rclpy" not in sys.modules
print(f"dotsim_ros {dotsim_ros.__version__}: {frame.wrench.force_n[2]:.3f} N at 1 mm")
