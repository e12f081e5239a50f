# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mixes of Ecoflex: a law fitted on one specimen of each, judged on the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.importers.ecoflex_compression import (
    CompressionTest,
    read_compression_tests,
)
from studies.data import REAL
from studies.real.cylinders import (
    FITTED_SPECIMEN,
    LAWS,
    SHARE,
    SLIP,
    STUCK,
    TARGET,
    TOLD_APART,
    Ends,
    chosen_law,
    fitted,
    slipping,
    sticking,
)

COMPARED_SHARE = 0.3
"""Compression at which the two specimens' forces are compared."""


def real_cylinders(*, data: Path = REAL / "ecoflex_compression") -> dict[str, Any]:
    """Laws of real gels between plates, fitted to one specimen and judged on another.

    Args:
        data: folder of the set, as published.

    Raises:
        FileNotFoundError, ValueError: as `read_compression_tests`; a mix with one specimen.
        CalculixMissingError: CalculiX is not installed.
    """
    tests = read_compression_tests(data)
    both = (slipping(), sticking())
    rows = []
    for mix in sorted({test.mix for test in tests}):
        of_mix = [test for test in tests if test.mix == mix]
        on = [test for test in of_mix if test.specimen == FITTED_SPECIMEN]
        others = [test for test in of_mix if test.specimen != FITTED_SPECIMEN]
        if not on or not others:
            raise ValueError(
                f"{data}: {mix} has no specimen {FITTED_SPECIMEN} or no other one; one is "
                "fitted on and another judged"
            )
        rows += [_row(mix, ends, on, others) for ends in both]
    return {
        "rows": rows,
        "verdicts": [_verdict(mix, rows) for mix in sorted({row["mix"] for row in rows})],
        "stuck_to": float(both[1].share[-1]),
        "stuck_over_slip": (
            both[1].force_n["C10"] / both[0].force_n["C10"][: len(both[1].share)]
        ).tolist(),
        "share": SHARE.tolist(),
    }


def _row(
    mix: str, ends: Ends, on: Sequence[CompressionTest], others: Sequence[CompressionTest]
) -> dict[str, Any]:
    law, errors = chosen_law(ends, on)
    found = fitted(ends, law, on)
    judged = np.abs(found.errors(others))
    own = np.abs(found.errors(on))
    here, there = (
        np.mean([test.force_at(np.array([COMPARED_SHARE]))[0] for test in group])
        for group in (on, others)
    )
    return {
        "mix": mix,
        "ends": ends.name,
        "to": float(ends.share[-1]),
        "law": law,
        "constants_pa": dict(zip(LAWS[law], found.constants_pa.tolist(), strict=True)),
        "choice_errors": errors,
        "fitted_tests": len(on),
        "judged_tests": len(others),
        "judged_specimens": len({test.specimen for test in others}),
        "own_mean": float(own.mean()),
        "mean": float(judged.mean()),
        "worst": float(judged.max()),
        "within": int((judged.max(axis=1) <= TARGET).sum()),
        "other_over_own": float(there / here),
    }


def _verdict(mix: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return which end the fitted specimen speaks for, by the rule and by one constant alone."""
    of_mix = {row["ends"]: row for row in rows if row["mix"] == mix}
    error = {name: min(row["choice_errors"].values()) for name, row in of_mix.items()}
    one = {name: row["choice_errors"]["neo_hookean"] for name, row in of_mix.items()}
    apart = abs(error[SLIP] - error[STUCK]) > TOLD_APART
    return {
        "mix": mix,
        "ends": min(error, key=lambda name: error[name]) if apart else "not told apart",
        "error": error,
        "one_constant": one,
    }
