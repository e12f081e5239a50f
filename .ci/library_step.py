# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One press with the installed library, in a venv that knows no ROS."""

import sys
import tempfile
from pathlib import Path

import dotsim_ros

HEAVY = {"warp", "torch", "rclpy"}
NEED_TORCH = {"ArrayFrame", "TactileArray"}


def check_light(what: str) -> None:
    """Fail where something heavy has been loaded."""
    loaded = HEAVY & set(sys.modules)
    assert not loaded, f"{what} loaded {', '.join(sorted(loaded))}"


check_light("importing dotsim_ros")
assert set(dotsim_ros.__all__) <= set(dir(dotsim_ros))
specification = dotsim_ros.load_sensor("densetact2")
check_light("reading a sensor")
sensor = dotsim_ros.TactileSensor.load(specification, indenter="sphere_4mm")
frame = sensor.step(dotsim_ros.Pose.above_apex(depth_m=0.001))
assert frame.image.shape == (480, 640, 3), frame.image.shape
assert frame.wrench.force_n[2] > 0.0, frame.wrench
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "press.png"
    frame.save(path)
    assert path.stat().st_size > 0
for name in set(dotsim_ros.__all__) - NEED_TORCH:
    assert getattr(dotsim_ros, name) is not None, name
for name in NEED_TORCH:
    # The library installs no torch.
    message = ""
    try:
        getattr(dotsim_ros, name)
    except ModuleNotFoundError as error:
        message = str(error)
    assert "dotsim_ros[learning]" in message, message
assert "rclpy" not in sys.modules
SHARED = Path(sys.prefix) / "share" / "dotsim_ros"
shared_bytes = sum(path.stat().st_size for path in SHARED.rglob("*") if path.is_file())
assert 0 < shared_bytes < 1_000_000, f"{shared_bytes} bytes below {SHARED}: data stands twice"
print(f"dotsim_ros {dotsim_ros.__version__}: {frame.wrench.force_n[2]:.3f} N at 1 mm")
