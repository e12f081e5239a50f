# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write what the package computes as one JSON file, to compare two commits on one machine.

    python tools/golden.py FILE [--data ../shared] [PART ...]

A change of the layout must leave every value as it is, to the last bit. Only names that stay are
used, so that the file runs at older commits, too: frames (60, in lockstep), find_gap, calibration,
loop (the hash of a simulated bag) and network (the error of a short training).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.geometry.pose import ApexPose
from dotsim_ros.sensor import TactileSensor

SENSORS = ("densetact2", "sensor_a", "gelsight_mini")
FRAMES = 20
PRESS_M, SLIDE_M = 0.08e-3, 0.2e-3
HALF = FRAMES // 2
OF_THE_RUN = ("command", "commit", "date", "fit_seconds")
"""What a calibration says of itself that differs from run to run."""


def command(verb: str, *options: object) -> None:
    """Run a verb; a gap that was found is no failure."""
    line = [sys.executable, "-m", "dotsim_ros.cli.main", verb, *map(str, options)]
    status = subprocess.run(line).returncode
    if status not in (0, 10, 11, 12):
        raise RuntimeError(f"{' '.join(line)} ended with status {status}")


def frames(_data: Path, _folder: Path) -> dict[str, Any]:
    """Press, then slide; return a hash of each sensor's images, skins and forces."""
    found = {}
    for name in SENSORS:
        sensor = TactileSensor.load(name, indenter="sphere_4mm")
        digest = hashlib.sha256()
        for number in range(FRAMES):
            slide_m = SLIDE_M * max(number - HALF, 0)
            frame = sensor.step(ApexPose(PRESS_M * min(number, HALF), x_m=slide_m))
            for array in (frame.image, frame.skin_position_m, frame.wrench.force_n):
                digest.update(np.ascontiguousarray(array).tobytes())
        found[name] = digest.hexdigest()
    return found


def find_gap(data: Path, folder: Path) -> dict[str, Any]:
    """Return verdict, names and intervals of three data sets."""
    hidden, given = Path("data"), data / "measured"
    open_options = ("--sensor", "sensor_a", "--indenters", given / "sensor_a/indenters")
    twin = hidden / "hidden_17"
    hidden_options = ("--sensor", twin / "sensor_a.yaml", "--discrepancy", twin / "discrepancy.npz")
    found = {}
    for measured, options in (
        (given / "open_none", open_options),
        (given / "open_friction", open_options),
        (hidden / "hidden_23/set_03", hidden_options),
    ):
        file = folder / f"{measured.name}.json"
        out = ("--out", folder / measured.name, "--json", file)
        command("find-gap", "--measured", measured, *options, *out)
        findings = json.loads(file.read_text())
        found[measured.name] = {
            key: findings[key] for key in ("verdict", "named", "alternatives", "candidates")
        }
    return found


def calibration(data: Path, folder: Path) -> dict[str, Any]:
    """Return what is fitted to four trajectories."""
    file = folder / "calibration.json"
    names = ("1_sphere_0", "1_sphere_slide_1", "2_cone_1", "4_torus_1")
    places = ("--out", folder / "sensor.yaml", "--run", folder / "run", "--json", file)
    source = ("--data", data / "measured" / "sensor_a", "--trajectories", *names)
    command("calibrate", *source, "--hold-out", 0, "--workers", 1, *places)
    figures = json.loads(file.read_text())
    return {key: value for key, value in figures.items() if key not in OF_THE_RUN}


def loop(_data: Path, folder: Path) -> dict[str, Any]:
    """Return the hash of the bag of a loop in simulated time."""
    file = folder / "loop.json"
    command("demo-loop", "--out", folder / "loop", "--laps", 0.2, "--json", file)
    return {"bag_sha256": json.loads(file.read_text())["bag_sha256"]}


def network(data: Path, folder: Path) -> dict[str, Any]:
    """Return the figures of a network after one pass."""
    file = folder / "network.json"
    source = ("--data", data / "measured" / "sensor_a", "--sensor", "sensor_a")
    names = ("1_sphere_0", "1_sphere_1", "2_cone_1", "4_torus_1")
    few = ("--trajectories", *names, "--epochs", 1, "--size", 64)
    command("train-optics", *source, *few, "--out", folder / "network", "--json", file)
    figures = json.loads(file.read_text())
    return {key: value for key, value in figures.items() if "psnr" in key}


PARTS = {each.__name__: each for each in (frames, find_gap, calibration, loop, network)}


def main() -> None:
    """Compute the parts and write them."""
    parser = argparse.ArgumentParser(description="Write what the package computes, to compare.")
    parser.add_argument("file", type=Path)
    parser.add_argument("parts", nargs="*", metavar="PART", help="of " + ", ".join(PARTS))
    parser.add_argument("--data", type=Path, default=Path("../shared"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = {name: PARTS[name](given.data, Path(folder)) for name in given.parts or PARTS}
    given.file.write_text(json.dumps(found, indent=1, sort_keys=True, default=str) + "\n")


if __name__ == "__main__":
    main()
