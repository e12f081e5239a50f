# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write small reports below a folder: of gaps, one for each verdict, and of a calibration."""

import sys
from pathlib import Path

from calibration_result import calibration
from gap_findings import EXAMPLES

from dotsim_ros.calibration.report import write_report as write_calibration
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.report.write import write_report as write_gap

folder = Path(sys.argv[1])
for name, findings in EXAMPLES.items():
    print(write_gap(folder / f"gap_{name}", findings(), effects=load_effects()))
print(write_calibration(folder / "calibration", calibration(), seed=0))
