# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulation of soft optical tactile sensors: gel, camera, and the ROS 2 nodes around them.

    from dotsim_ros import Pose, TactileSensor

    sensor = TactileSensor.load("densetact2", indenter="sphere_4mm")
    frame = sensor.step(Pose.above_apex(depth_m=0.002))
    print(frame)
    frame.save("press.png")  # image, change and range side by side

`__all__` lists the public names. Each is loaded when it is first asked for, so importing this
package loads neither Warp nor torch nor rclpy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dotsim_ros.io.moved import forward_moved

__version__ = "0.1.0"

__all__ = [
    "ArrayFrame",
    "Calibration",
    "DataSet",
    "DataSetWriter",
    "Effect",
    "Findings",
    "Frame",
    "GelFailureError",
    "Indenter",
    "Pose",
    "SensorSpecification",
    "TactileArray",
    "TactileSensor",
    "Trajectory",
    "Verdict",
    "Wrench",
    "calibrate",
    "find_gap",
    "load_effects",
    "load_indenter",
    "load_sensor",
    "make_gel_batch",
    "read_data_set",
    "trajectory_of_frames",
    "write_data_set",
    "write_sensor",
]

_HOMES = {
    "dotsim_ros.sensor": ("Frame", "GelFailureError", "TactileSensor"),
    "dotsim_ros.tactile_array": ("ArrayFrame", "TactileArray"),
    "dotsim_ros.specification": ("SensorSpecification", "load_sensor", "write_sensor"),
    "dotsim_ros.geometry.pose": ("Pose", "Wrench"),
    "dotsim_ros.geometry.indenter": ("Indenter", "load_indenter"),
    "dotsim_ros.gel.make": ("make_gel_batch",),
    "dotsim_ros.data.data_set": ("DataSet", "read_data_set"),
    "dotsim_ros.data.data_set_writer": (
        "DataSetWriter",
        "trajectory_of_frames",
        "write_data_set",
    ),
    "dotsim_ros.data.trajectory": ("Trajectory",),
    "dotsim_ros.calibration.calibrate": ("calibrate",),
    "dotsim_ros.calibration.run": ("Calibration",),
    "dotsim_ros.effects.effect": ("Effect",),
    "dotsim_ros.effects.library": ("load_effects",),
    "dotsim_ros.gap.find": ("find_gap",),
    "dotsim_ros.gap.findings": ("Findings", "Verdict"),
}
"""Which module each public name lives in."""

if TYPE_CHECKING:
    from dotsim_ros.calibration.calibrate import calibrate
    from dotsim_ros.calibration.run import Calibration
    from dotsim_ros.data.data_set import DataSet, read_data_set
    from dotsim_ros.data.data_set_writer import (
        DataSetWriter,
        trajectory_of_frames,
        write_data_set,
    )
    from dotsim_ros.data.trajectory import Trajectory
    from dotsim_ros.effects.effect import Effect
    from dotsim_ros.effects.library import load_effects
    from dotsim_ros.gap.find import find_gap
    from dotsim_ros.gap.findings import Findings, Verdict
    from dotsim_ros.gel.make import make_gel_batch
    from dotsim_ros.geometry.indenter import Indenter, load_indenter
    from dotsim_ros.geometry.pose import Pose, Wrench
    from dotsim_ros.sensor import Frame, GelFailureError, TactileSensor
    from dotsim_ros.specification import SensorSpecification, load_sensor, write_sensor
    from dotsim_ros.tactile_array import ArrayFrame, TactileArray
else:
    # A type checker reads the imports above, so that it refuses names that are none of these.
    def __getattr__(name: str) -> object:
        """Return a public name; it is loaded once."""
        for module, names in _HOMES.items():
            if name in names:
                from importlib import import_module

                try:
                    home = import_module(module)
                except ModuleNotFoundError as error:
                    if error.name != "torch":
                        raise
                    raise ModuleNotFoundError(
                        f"dotsim_ros.{name} needs torch, which is not installed: "
                        "pip install 'dotsim_ros[learning]'",
                        name="torch",
                    ) from error
                globals()[name] = value = getattr(home, name)
                return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


forward_moved()
