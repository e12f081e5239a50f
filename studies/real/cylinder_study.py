# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mixes of Ecoflex: a law fitted on one specimen of each, judged on the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.measured.importers.ecoflex_compression import (
    CompressionTest,
    read_compression_tests,
)
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
from studies.table import entry_list

COMPARED_SHARE = 0.3
"""Compression at which the two specimens' forces are compared."""


def evaluate_cylinders(directory: Path, *, progress: Callable[[str], None]) -> dict[str, Any]:
    """Return the figures of one set.

    Args:
        directory: of the set, as published.
        progress: told what is done.

    Raises:
        FileNotFoundError, ValueError: as `read_compression_tests`; a mix with one specimen.
        CalculixMissingError: CalculiX is not installed.
    """
    tests = read_compression_tests(directory)
    both = (slipping(), sticking(progress=progress))
    rows = []
    for mix in sorted({test.mix for test in tests}):
        of_mix = [test for test in tests if test.mix == mix]
        on = [test for test in of_mix if test.specimen == FITTED_SPECIMEN]
        others = [test for test in of_mix if test.specimen != FITTED_SPECIMEN]
        if not on or not others:
            raise ValueError(
                f"{directory}: {mix} has no specimen {FITTED_SPECIMEN} or no other one; one is "
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


def cylinders_page(figures: dict[str, Any]) -> str:
    """Return the page."""
    rows, verdicts = figures["rows"], figures["verdicts"]
    slip = [row for row in rows if row["ends"] == SLIP]
    fitted_tests, judged_tests = (
        sum(row[key] for row in slip) for key in ("fitted_tests", "judged_tests")
    )
    lines = [
        "# Cylinders of Ecoflex between plates",
        "",
        f"{len(slip)} mixes of two specimens each. The law is chosen and fitted on specimen",
        f"{FITTED_SPECIMEN} ({fitted_tests} tests in all) and judged on the other one "
        f"({judged_tests} tests), which the rule never saw, from {100 * SHARE[0]:.0f} % of",
        "compression to the one in the column *to*. The law is the one with the least error on",
        f"repeats 4 and 5 of specimen {FITTED_SPECIMEN}, fitted on 1 to 3. *Within*: "
        "judged tests whose force is within",
        f"{100 * TARGET:.0f} % all the way. *Other/own*: force of the judged specimen over",
        "the fitted one's at 30 %, which no law can make up for.",
        "",
        "| mix | plates | to | law | constants kPa | own error | error | worst | within "
        "| other/own |",
        "| --- | --- | ---: | --- | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in rows:
        constants = ", ".join(f"{k} {1e-3 * v:.2f}" for k, v in row["constants_pa"].items())
        lines.append(
            f"| {row['mix']} | {row['ends']} | {100 * row['to']:.0f} % | {row['law']} | "
            f"{constants} | {100 * row['own_mean']:.1f} % | {100 * row['mean']:.1f} % | "
            f"{100 * row['worst']:.1f} % | {row['within']} of {row['judged_tests']} | "
            f"{row['other_over_own']:.3f} |"
        )
    for name in (SLIP, STUCK):
        group = [row for row in rows if row["ends"] == name]
        within, judged = (sum(row[key] for row in group) for key in ("within", "judged_tests"))
        good = sum(row["mean"] <= TARGET for row in group)
        lines += [
            "",
            f"Plates with {name}: {within} of {judged} judged tests within {100 * TARGET:.0f} %",
            f"all the way; the mean error is within it for {good} of {len(group)} mixes.",
        ]
    lines += [
        "",
        "## Slip or stuck",
        "",
        f"An end is named where the chosen laws' errors on specimen {FITTED_SPECIMEN} differ by",
        f"more than {100 * TOLD_APART:.0f} percentage point.",
        "",
        "| mix | verdict | error slip | stuck | one constant: slip | stuck |",
        "| --- | --- | ---: | ---: | ---: | ---: |",
    ]
    for row in verdicts:
        figure = [row[key][name] for key in ("error", "one_constant") for name in (SLIP, STUCK)]
        lines.append(
            f"| {row['mix']} | {row['ends']} | "
            + " | ".join(f"{100 * v:.1f} %" for v in figure)
            + " |"
        )
    ratios = ", ".join(
        f"{ratio:.2f} at {100 * share:.0f} %"
        for share, ratio in zip(figures["share"], figures["stuck_over_slip"], strict=False)
    )
    lines += ["", f"A stuck neo-Hookean cylinder's force over that of one that slips: {ratios}."]
    return "\n".join(lines) + "\n\n" + entry_list(figures["provenance"])
