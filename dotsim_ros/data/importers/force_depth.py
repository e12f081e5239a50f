# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Force against depth, as published tables have it: units, order and plausibility.

A table says its units in its column names (`depth_mm`, `normal_force_N`). That they are right is
checked by the stiffness that they give: silicone gels span three decades, while grams for newtons
or inches for millimetres are off by two or more.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set import STANDARD_GRAVITY_M_S2
from dotsim_ros.data.trajectory import PoseChannel, Trajectory, WrenchChannel
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.io.documents import Table, read_table

DEPTH_UNITS_M = {"mm": 1e-3, "m": 1.0, "um": 1e-6, "in": 0.0254}
FORCE_UNITS_N = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "g": 1e-3 * STANDARD_GRAVITY_M_S2,
    "kg": STANDARD_GRAVITY_M_S2,
}
SOFTEST_PA, STIFFEST_PA = 1.0e3, 1.0e7
"""Young's moduli, as a half-space or a free column has them, that are taken for a gel's."""
NOISE_SHARE = 0.02
"""Of the largest force, and of the largest depth: what goes back by less is noise."""
EARLIEST_SHARE = 0.1
"""Of the largest depth: a gel that is touched at 0 has answered by then."""
SILENT_SHARE = 0.002
"""Of the largest force: less is no answer. A column of gel has 2 % by a tenth of two thirds."""


@dataclass(frozen=True)
class ForceDepth:
    """A force (N,) that pushes the indenter out, against its depth (N,) in the gel at rest."""

    depth_m: FloatArray
    force_n: FloatArray


def upright_press(
    stamp_ns: IntArray, height_m: FloatArray, force_n: FloatArray, name: str
) -> Trajectory:
    """Return a press along the base frame's z axis, by an indenter that is not turned, from the
    height of its frame over the base and the force along z."""
    count = len(stamp_ns)
    position, force, turn = (np.zeros((count, width)) for width in (3, 3, 4))
    position[:, 2], force[:, 2], turn[:, 3] = height_m, force_n, 1.0
    return Trajectory(
        pose=PoseChannel(stamp_ns, position, turn),
        wrench=WrenchChannel(stamp_ns, force, np.zeros((count, 3))),
        name=name,
    )


def read_force_table(path: str | Path) -> ForceDepth:
    """Read a table with the columns depth_UNIT and normal_force_UNIT, depths in rising order.

    Units of depth are mm, m, um and in, of force N, mN, kN, g and kg (the weight of a mass).

    Raises:
        FileNotFoundError: no such file.
        ValueError: a column that is missing, there twice or without a known unit, a cell that is no
            number, no row, depths that do not rise, or as `read_table`.
    """
    table = read_table(path)
    depth, metres = _column(table, "depth", DEPTH_UNITS_M)
    force, newtons = _column(table, "normal_force", FORCE_UNITS_N)
    curve = ForceDepth(table.numbers(depth) * metres, table.numbers(force) * newtons)
    if not table.rows:
        raise ValueError(f"{path}: expected rows of numbers, got none below the names")
    falls = np.flatnonzero(np.diff(curve.depth_m) <= 0.0)
    if falls.size:
        before, after = 1e3 * curve.depth_m[falls[0] : falls[0] + 2]
        raise ValueError(
            f"{path}, line {table.lines[falls[0] + 1]}, column {depth}: {after:g} mm after "
            f"{before:g} mm, expected depths that rise; sort the rows, and give each press its own "
            "table"
        )
    return curve


def _column(table: Table, quantity: str, units: dict[str, float]) -> tuple[str, float]:
    """Return the name of a quantity's column and its unit in SI."""
    named = [n for n in table.columns if n == quantity or n.startswith(f"{quantity}_")]
    expected = ", ".join(f"{quantity}_{unit}" for unit in units)
    if len(named) != 1:
        raise ValueError(
            f"{table.place}: {len(named) or 'no'} column{'s' if len(named) > 1 else ''} of "
            f"{quantity} among {', '.join(table.columns) or 'none'}; expected one of {expected}"
        )
    unit = named[0].removeprefix(quantity).removeprefix("_")
    if unit not in units:
        raise ValueError(
            f"{table.place}: the column {named[0]} has no unit that is known; rename it to one of "
            f"{expected}"
        )
    return named[0], units[unit]


def check_stiffness(place: str, modulus_pa: float) -> None:
    """Refuse a force and a depth, by the Young's modulus that they give to a factor of some.

    Raises:
        ValueError: no gel has it.
    """
    if not SOFTEST_PA <= modulus_pa <= STIFFEST_PA:
        raise ValueError(
            f"{place}: force and depth are those of a Young's modulus of {modulus_pa:.3g} Pa, "
            f"expected {SOFTEST_PA:g} to {STIFFEST_PA:g} Pa as gels have; check the units: grams "
            "for newtons are 102 times too large, inches for millimetres 25 times too small"
        )


def check_within(place: str, depth_m: float, thickness_m: float) -> None:
    """Refuse a depth that the gel has not.

    Raises:
        ValueError: it is not below the gel's thickness.
    """
    if not depth_m < thickness_m:
        raise ValueError(
            f"{place}: a depth of {1e3 * depth_m:g} mm in a gel of {1e3 * thickness_m:g} mm; check "
            "the unit of depth (mm, m, um, in)"
        )


def check_in_step(place: str, time_s: FloatArray, curve: ForceDepth) -> None:
    """Refuse a force that runs late behind its depth.

    A gel's force peaks with the depth, or before it where it relaxes, never after it; and it is
    there as soon as the gel is touched, which must be at a depth of 0.

    Raises:
        ValueError: it does.
    """
    depth, force = curve.depth_m, curve.force_n
    deepest, strongest = int(depth.argmax()), int(force.argmax())
    falls_back = depth[deepest] - depth[-1] > NOISE_SHARE * np.ptp(depth)
    if falls_back and depth[deepest] - depth[strongest] > NOISE_SHARE * np.ptp(depth):
        late = time_s[strongest] - time_s[deepest]
        if late > 0.0:
            raise ValueError(
                f"{place}: the force is largest {late:.3g} s after the depth, expected at the same "
                "time or before; the force runs late: shift its stamps by so much, or record both "
                "on one clock"
            )
    early = depth <= EARLIEST_SHARE * depth[deepest]
    early[deepest:] = False
    answered = force[early].max(initial=-np.inf) > SILENT_SHARE * force.max()
    if early.sum() >= 2 and not answered:
        first = int(np.flatnonzero(force > SILENT_SHARE * force.max())[0])
        raise ValueError(
            f"{place}: no force until {1e3 * depth[first]:.2f} mm, {time_s[first] - time_s[0]:.3g} "
            "s after the start, expected it from first contact at 0 on; the force runs late, or "
            "depth does not count from contact: shift the one or subtract from the other"
        )
