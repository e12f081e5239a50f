# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cylinders of Ecoflex between plates (Dawood, Zhang, Suulker, Osman, Abdulali, Angelmahr,
Althoefer, "Hyperelastic Characterisation of Silicone Tissue Phantoms", 2026, CC BY 4.0).

`compression.npz` holds one array a test, named MIX_SPECIMEN+REPEAT (`EF30_25T_A1`: Ecoflex 00-30
with 25 % thinner, specimen A, first repeat), with the columns time s, compression mm and load N.
Loading only. Not recorded: friction of the plates, lubrication, temperature.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.importers.force_depth import (
    NOISE_SHARE,
    ForceDepth,
    check_in_step,
    check_stiffness,
    check_within,
    upright_press,
)
from dotsim_ros.data.trajectory import Trajectory
from dotsim_ros.geometry.indenter import Indenter, flat_punch
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import read_arrays

TESTS = "compression.npz"
RADIUS_M, HEIGHT_M = 0.025, 0.030
"""Of the cylinders."""
COLUMNS = 3
PLATE_RADIUS_M, PLATE_THICKNESS_M = 0.060, 0.010
"""Of the plate in the data set: wider than any cylinder bulges; its size was not recorded."""
PLATE_STEP_M = 5.0e-3
"""Of its written mesh: it is flat."""
JUDGED_SHARE = 0.2
"""Of the height: the compression at which stiffness is checked."""
_NAME = re.compile(r"(?P<mix>\w+)_(?P<specimen>[A-Z])(?P<repeat>\d+)")


@dataclass(frozen=True)
class CompressionTest:
    """One test, N points.

    Attributes:
        name: as published.
        mix: base and thinner, as "EF30_25T".
        specimen: which casting.
        repeat: from 1.
        time_s: (N,) increasing.
        curve: compression and load.
    """

    name: str
    mix: str
    specimen: str
    repeat: int
    time_s: FloatArray
    curve: ForceDepth

    def force_at(self, share: FloatArray) -> FloatArray:
        """Return the load, N, at compressions that are shares of the height."""
        return np.interp(np.asarray(share) * HEIGHT_M, self.curve.depth_m, self.curve.force_n)


def read_compression_tests(directory: str | Path) -> tuple[CompressionTest, ...]:
    """Read the tests of a folder that holds compression.npz.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no such file; the text names the test.
    """
    path = Path(directory) / TESTS
    arrays = read_arrays(path)
    if not arrays:
        raise ValueError(f"{path} holds no test; expected arrays named as EF30_25T_A1")
    return tuple(_test(name, arrays[name], f"{path}: {name}") for name in sorted(arrays))


def _test(name: str, rows: NDArray[Any], place: str) -> CompressionTest:
    named = _NAME.fullmatch(name)
    if named is None:
        raise ValueError(f"{place} is no name of a test; expected MIX_SPECIMEN+REPEAT")
    if rows.ndim != 2 or rows.shape[1] != COLUMNS or len(rows) < 3 or rows.dtype.kind not in "fiu":
        raise ValueError(
            f"{place} is {rows.dtype} of shape {rows.shape}, expected numbers of shape (N, 3): "
            "time s, compression mm, load N"
        )
    table = rows.astype(np.float64)
    if not np.isfinite(table).all():
        raise ValueError(f"{place} holds a number that is not finite")
    time_s, depth_m, force_n = table[:, 0], 1e-3 * table[:, 1], table[:, 2]
    if (np.diff(time_s) <= 0.0).any():
        at = int(np.flatnonzero(np.diff(time_s) <= 0.0)[0]) + 1
        raise ValueError(f"{place}: row {at} is not later than the one before")
    check_within(place, float(depth_m.max()), HEIGHT_M)
    back_m = np.maximum.accumulate(depth_m) - depth_m
    curve = ForceDepth(depth_m, force_n)
    check_in_step(place, time_s, curve)
    if back_m.max() > NOISE_SHARE * depth_m.max():
        at = int(back_m.argmax())
        raise ValueError(
            f"{place}: the compression goes back by {1e3 * back_m[at]:.3g} mm at row {at}, "
            "expected loading only; cut the test at its largest compression"
        )
    at_m = JUDGED_SHARE * HEIGHT_M
    if depth_m.max() < at_m:
        raise ValueError(
            f"{place}: the largest compression is {1e3 * depth_m.max():.3g} mm, expected at least "
            f"{1e3 * at_m:g} mm of a cylinder of {1e3 * HEIGHT_M:g} mm; are these inches?"
        )
    force = float(np.interp(at_m, depth_m, force_n))
    check_stiffness(place, force * HEIGHT_M / (np.pi * RADIUS_M**2 * at_m))
    return CompressionTest(
        name, named["mix"], named["specimen"], int(named["repeat"]), time_s, curve
    )


def plate() -> Indenter:
    """Return the upper plate."""
    return replace(flat_punch(PLATE_RADIUS_M, PLATE_THICKNESS_M), name="plate")


def _trajectories(tests: tuple[CompressionTest, ...]) -> Iterator[tuple[Trajectory, Indenter]]:
    upper = plate()
    for test in tests:
        stamp_ns = np.round(1e9 * (1.0 + test.time_s)).astype(np.int64)
        height_m = HEIGHT_M - test.curve.depth_m
        yield upright_press(stamp_ns, height_m, test.curve.force_n, test.name), upper


def import_ecoflex_compression(source: Path, out: Path) -> DataSet:
    """Write the tests as a data set; the base frame lies in the middle of the lower plate.

    Raises:
        FileExistsError, FileNotFoundError, ValueError: as `read_compression_tests` and
            `write_data_set`.
    """
    tests = read_compression_tests(source)
    return write_data_set(out, _trajectories(tests), indenter_step_m=PLATE_STEP_M)
