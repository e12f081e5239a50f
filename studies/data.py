# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the measured and the real data of the studies lie."""

import os
from pathlib import Path

DATA = Path(os.environ.get("DOTSIM_ROS_DATA", "../shared"))
MEASURED = DATA / "measured"
REAL = DATA / "real"
SENSOR_A = MEASURED / "sensor_a"
