# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compare eight short motions with kept values, so that no change of behaviour passes unseen.

    python tools/canary.py [--keep] [MOTION ...]

Compared are the wrench on the indenter in every frame, and of the last frame the places of some
markers of the skin, the image's mean levels by tile, the points of the skin that some pixels see,
and the printed markers in the image. Ends with status 1 where one differs by more than its
tolerance. With `--keep` the new values are written; the commit that does so says why they changed.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import warp as wp

from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import ApexPose, Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.files import write_text
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, load_sensor

KEPT = Path(__file__).resolve().parents[1] / "test" / "canary" / "kept.json"
LEVER_M = 0.01
"""Makes a force of a torque: about the distance of a contact from the base frame's origin."""
EVERY_MARKER = 20
TILE_PX = 40


@dataclass(frozen=True)
class Quantity:
    """What is compared, by its largest difference.

    Attributes:
        unit: of the difference.
        tolerance: largest difference that passes.
        decimals: that are kept, finer than the tolerance.
        axes: what the axes of the array count.
    """

    unit: str
    tolerance: float
    decimals: int
    axes: tuple[str, ...]


# A tolerance lies far above what rounding makes of the same code, and below half of what 2 % of a
# constant make. Rounding was measured with OpenBLAS's kernels for Nehalem, Sandy Bridge and
# Haswell, with tables of the gel that such kernels made, without vector instructions of numpy and
# of Warp's compiler, with two threads, and with poses moved by 1 nm. A solver that takes another
# way ends elsewhere within its own tolerance of 10 um, some um and up to 1 % of the force away:
# that is a change of behaviour, and not let through.
QUANTITIES = {
    # Rounding: 0.003 %, and 0.1 % where the search for a force ends a trial sooner. 2 % of E: 2 %;
    # of friction: 1.4 % in a slide.
    "force": Quantity("%", 0.3, 5, ("frame", "component")),
    # Rounding: 0.02 um, and 1 um by that search. 2 % of friction: 20 um in a slide; of E: 13 um
    # under a held force.
    "skin": Quantity("um", 2.0, 1, (f"marker, in steps of {EVERY_MARKER}", "axis")),
    # Rounding: 0.002 levels; a pixel that is rounded to another level moves the mean of a tile by
    # 0.0006. 2 % of friction: 0.1 levels in a slide.
    "image": Quantity("levels", 0.03, 3, ("tile row", "tile column", "colour")),
    # Rounding: as the skin's. 2 % of the tilt of gelslim's camera: 540 um.
    "seen": Quantity("um", 2.0, 1, ("tile row", "tile column", "axis")),
    # Rounding: 0.0001 px. 2 % of friction: 0.1 px in a slide.
    "markers": Quantity("px", 0.02, 3, ("marker", "axis")),
}


@dataclass(frozen=True)
class Motion:
    """What presses which sensor: along poses, or until it gives one force after the other.

    Attributes:
        sensor, indenter: names, as `TactileSensor.load` takes them.
        poses: of the indenter.
        forces_n: normal forces, in place of poses.
        coarse: whether the gel has a coarse grid, whose tables are made in no time.
    """

    sensor: str
    indenter: str
    poses: tuple[ApexPose, ...] = ()
    forces_n: tuple[float, ...] = ()
    coarse: bool = False

    def specification(self) -> SensorSpecification:
        """Return the sensor, as it is shipped but for the grid."""
        sensor = load_sensor(self.sensor)
        if not self.coarse:
            return sensor
        return replace(sensor, solver=replace(sensor.solver, grid_spacing_m=4e-3, refined=False))


def press(depth_mm: float, x_mm: float, y_mm: float, yaw_rad: float = 0.0) -> tuple[ApexPose, ...]:
    """Return four poses straight down to a depth."""
    depths_m = 1e-3 * depth_mm * np.arange(1, 5) / 4
    return tuple(ApexPose(depth_m, 1e-3 * x_mm, 1e-3 * y_mm, yaw_rad) for depth_m in depths_m)


def slide(depth_mm: float, x_mm: float, y_mm: float, length_mm: float) -> tuple[ApexPose, ...]:
    """Return the poses of a press, and of a slide along x in steps of 0.3 mm."""
    places_m = 1e-3 * (x_mm + np.arange(0.3, length_mm + 0.1, 0.3))
    way = tuple(ApexPose(1e-3 * depth_mm, x_m, 1e-3 * y_mm) for x_m in places_m)
    return press(depth_mm, x_mm, y_mm) + way


MOTIONS = {
    "ball": Motion("densetact2", "sphere_4mm", press(1.5, 0.8, -0.5) + press(0.8, 0.8, -0.5)[-1:]),
    "cone": Motion("densetact2", "cone", press(1.5, 2.0, 1.0)),
    "edge": Motion("densetact2", "box_edge", press(1.2, 0.5, 0.3, yaw_rad=0.5)),
    "flat_face": Motion("gelslim", "flat_punch", press(0.6, 1.0, -1.0)),
    "slide": Motion("densetact2", "sphere_4mm", slide(1.0, -1.0, 0.5, 2.4)),
    "markers": Motion("gelsight_mini_markers", "sphere_4mm", slide(0.8, -0.5, 1.0, 1.2)),
    "learned_image": Motion("sensor_a", "sphere_4mm", press(1.5, -1.0, 2.0), coarse=True),
    "held_force": Motion("densetact2", "sphere_4mm", forces_n=(0.3, 0.6, 1.0)),
}


@cache
def sensor_of(specification: SensorSpecification) -> TactileSensor:
    """Return the sensor, made once for all motions of it."""
    return TactileSensor.load(specification)


def observe(motion: Motion, specification: SensorSpecification) -> dict[str, FloatArray]:
    """Return what is compared, by quantity, of a motion on a sensor."""
    sensor = sensor_of(specification)
    sensor.set_indenter(load_indenter(motion.indenter))
    pose: Pose | ApexPose = ApexPose(x_m=0.5e-3)
    wrenches = []
    for pose in motion.poses:
        gel = sensor.press(pose)
        wrenches.append(gel.wrench)
    for force_n in motion.forces_n:
        gel, pose = sensor.press_to_force(pose, force_n)
        wrenches.append(gel.wrench)
    frame = sensor.see(gel, pose)
    rows, columns = (length // TILE_PX for length in frame.image.shape[:2])
    part = frame.image[: rows * TILE_PX, : columns * TILE_PX]
    middle = slice(TILE_PX // 2, None, TILE_PX)
    found = {
        "force": np.array([[*w.force_n, *w.torque_nm / LEVER_M] for w in wrenches]),
        "skin": 1e6 * frame.skin_position_m[::EVERY_MARKER],
        "image": part.reshape(rows, TILE_PX, columns, TILE_PX, 3).mean(axis=(1, 3)),
        # A pixel that sees no skin sees the origin.
        "seen": 1e6 * np.nan_to_num(frame.material_point_m[middle, middle].astype(np.float64)),
    }
    if sensor.markers is not None:
        found["markers"] = sensor.marker_motion(frame.skin_position_m).position_px
    return found


def compare(
    found: Mapping[str, FloatArray], kept: Mapping[str, FloatArray]
) -> dict[str, tuple[float, str]]:
    """Return the largest difference of each quantity, and what to say of it: "" if it passes."""
    differences = {}
    for name in [name for name in QUANTITIES if name in found or name in kept]:
        quantity, now, before = QUANTITIES[name], found.get(name), kept.get(name)
        if now is None or before is None or now.shape != before.shape:
            differences[name] = np.inf, f"{name} has other numbers than are kept, or none"
            continue
        scale = 100.0 / np.linalg.norm(before[:, :3], axis=1).max() if name == "force" else 1.0
        difference = scale * np.abs(now - before)
        at = np.unravel_index(np.argmax(difference), difference.shape)
        place = ", ".join(f"{axis} {i}" for axis, i in zip(quantity.axes, at, strict=True))
        # Asked this way, not a number does not pass.
        passes = difference[at] <= quantity.tolerance
        words = f"{name} is {now[at]:.6g}, kept is {before[at]:.6g} ({place})"
        differences[name] = float(difference[at]), "" if passes else words
    return differences


def read_kept() -> dict[str, dict[str, FloatArray]]:
    """Return the kept values by motion and quantity."""
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.is_file() else {}
    return {m: {q: np.array(v) for q, v in values.items()} for m, values in kept.items()}


def write_kept(kept: Mapping[str, Mapping[str, FloatArray]]) -> None:
    """Write the kept values, a motion a line."""
    lines = []
    for motion, found in kept.items():
        # + 0.0: no sign of a rounded zero.
        rounded = {q: (v.round(QUANTITIES[q].decimals) + 0.0).tolist() for q, v in found.items()}
        lines.append(f'"{motion}":{json.dumps(rounded, separators=(",", ":"))}')
    KEPT.parent.mkdir(exist_ok=True)
    write_text(KEPT, "{\n" + ",\n".join(lines) + "\n}\n")


def main() -> int:
    """Compare, and keep where that is asked for; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("motion", nargs="*", help=f"{', '.join(MOTIONS)}; without one all")
    parser.add_argument("--keep", action="store_true", help="write new values")
    arguments = parser.parse_args()
    if unknown := set(arguments.motion) - set(MOTIONS):
        parser.error(f"unknown motion {', '.join(unknown)}, expected {', '.join(MOTIONS)}")
    wp.config.log_level = logging.WARNING
    kept, failures = read_kept(), []
    print(f"{'':13}", *(f"{f'{name}, {q.unit}':>14}" for name, q in QUANTITIES.items()))
    print(f"{'tolerance':13}", *(f"{q.tolerance:14g}" for q in QUANTITIES.values()))
    for name in arguments.motion or MOTIONS:
        found, wrong = {}, []
        try:
            found = observe(MOTIONS[name], MOTIONS[name].specification())
        # Whatever it is: a motion that breaks off must not hide what becomes of the others.
        except Exception as error:
            wrong.append(f"{type(error).__name__}: {error}")
        differences = compare(found, kept.get(name, {}))
        wrong += [words for _, words in differences.values() if words]
        cells = (f"{differences[q][0]:14.4f}" if q in differences else 14 * " " for q in QUANTITIES)
        print(f"{name:13}", *cells, " FAIL" if wrong else " pass", flush=True)
        failures += [f"{name}: {words}" for words in wrong]
        kept[name] = found
    print(*failures, sep="\n")
    if arguments.keep and all(kept.values()):
        write_kept(kept)
        print(f"{KEPT} holds the new values: say in the commit why they changed")
        return 0
    if failures:
        print(
            "The behaviour is not what was kept. python tools/canary.py MOTION shows one alone,\n"
            "and git bisect run python tools/canary.py MOTION finds the commit. If the change is\n"
            "meant, make canary KEEP=1 writes the new values, and the commit says why."
        )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
