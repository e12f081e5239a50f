# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of the gap finder's blind study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.decision import HEAVIER
from studies.table import entry_list


def _shown(rate: Mapping[str, Any]) -> str:
    if rate["of"] == 0:
        return "no case"
    return f"{rate['share']:.0%} [{rate['low']:.0%}, {rate['high']:.0%}] of {rate['of']}"


def _of_one(share: float | None) -> str:
    return "-" if share is None else f"{share:.0%}"


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [" | ".join(header), " | ".join("---" for _ in header)]
    lines += [" | ".join(row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def _limit_rows(limits: Mapping[str, Any]) -> list[tuple[str, ...]]:
    library = load_effects()
    rows = []
    for name, ends in limits["absolute"].items():
        for end in ends:
            unit = library[name].parameters[0].unit
            sizes = [limits[mode].get(name, {}).get(end) for mode in ("absolute", "differential")]
            rows.append((name, end, *(_limit(size, unit) for size in sizes)))
    return rows


def _limit(found: Mapping[str, Any] | None, unit: str) -> str:
    if found is None or found["size"] is None:
        return "-"
    return f"{found['size']:.3g} {unit}".rstrip() + f" (whitened {found['whitened_size']:g})"


def _power_rows(power: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            f"{row['size']:.3g} {of_law['unit']}",
            f"{row['whitened_size']:.1f}",
            _shown(row["named_right"]),
        )
        for name, of_law in power.items()
        for row in of_law["sizes"]
    ]


def gap_page(figures: dict[str, Any]) -> str:
    """Return the study as a Markdown page."""
    nulls, added, same = figures["nulls"], figures["after_adding"], figures["same_law"]
    others = figures["baselines"]
    closed = others["median_share_closed_from_20"]
    biases, factors = figures["bias"], figures["limit_factors"]
    return "\n".join(
        [
            "# Power of the gap finder: hidden effects of our own gel\n",
            "Presses of an independent finite-element solver in which nothing is missing; a hidden "
            "effect adds what a law of its own, none of the library's, makes of our gel. Half of "
            "the presses show the finder how far model and measurement are apart without an "
            "effect, the twin's bias, and how much effects gain by it; the cases are drawn "
            "from the other half, then the halves change places: eight trajectories (twelve in a "
            "quarter of the single effects), Young's modulus off by 5 % (one deviation). Effects "
            "are simulated at several sizes beforehand, in place of the refits of a search. "
            "Laws that are the library's own formulas in other letters are left out. Intervals "
            "are of 95 %; cases share presses, so that their width is the jackknife's over presses "
            "(Wilson's, of as many cases as have that variance). "
            "There is no hold in these presses: relaxation shows in loads, slides and releases.\n",
            _table(
                ("", "share", "goal"),
                [
                    ("nulls with a name", _shown(nulls["false_names"]), "at most 2 %"),
                    ("nulls called a gap at all", _shown(nulls["false_alarms"]), ""),
                    *(
                        (
                            f"named right (or in a set of two), whitened size {size}",
                            _shown(rate),
                            {"20 to 40": "85 %", "40 to inf": "95 %"}.get(size, ""),
                        )
                        for size, rate in figures["named_right_by_whitened_size"].items()
                    ),
                    (
                        "named right (or in a set of two), over all sizes",
                        _shown(figures["named_right_over_all_sizes"]),
                        "",
                    ),
                    (
                        "outside of the library, called unknown (whitened size above 10)",
                        _shown(figures["unknown_called_unknown"]),
                        "90 %",
                    ),
                    (
                        "the same, where no effect's signature is like it (cosine below 0.9)",
                        _shown(figures["unimitated_called_unknown"]),
                        "90 %",
                    ),
                    ("both of two, whatever they are", _shown(figures["both_of_two"]), "80 %"),
                    (
                        "both of two, each of whitened size 10 or more",
                        _shown(figures["both_of_two_from_10"]),
                        "80 %",
                    ),
                    ("one of two at least", _shown(figures["one_of_two"]), ""),
                    ("a wrong one in a pair", _shown(figures["wrong_in_pairs"]), "at most 10 %"),
                    ("answered with a set", _shown(figures["set_share"]), ""),
                ],
            ),
            "## Power over all sizes that were hidden\n",
            _table(("law", "size", "whitened size", "named right"), _power_rows(figures["power"])),
            "## After adding, on trajectories that were not searched\n",
            _table(
                ("", "", "goal"),
                [
                    (
                        "RMS at most 1.2 times that without the hidden effect",
                        _shown(added["within_1.2_of_the_floor"]),
                        "90 %",
                    ),
                    (
                        "share of the gap closed, median",
                        _of_one(added["median_share_closed"]),
                        "85 %",
                    ),
                    (
                        "the same where one effect is hidden",
                        _of_one(added["median_share_closed_single"]),
                        "",
                    ),
                    (
                        "worse than recalibration alone",
                        _shown(added["worse_than_recalibrated"]),
                        "never",
                    ),
                    (
                        "worse by more than 1 % of the RMS",
                        _shown(added["worse_by_one_percent"]),
                        "never",
                    ),
                    (
                        "same law: error of the size, median",
                        _of_one(same["median_relative_error"]),
                        "10 %",
                    ),
                    (
                        "same law: 95 % intervals that cover",
                        _shown(same["interval_covers"]),
                        "90 to 99 %",
                    ),
                    (
                        "same law: named alone, whitened size 10 or more",
                        _shown(same["named_alone_from_10"]),
                        "",
                    ),
                ],
            ),
            "## Beside simpler methods\n",
            "The lasso sees the same columns; recalibration and the black box (a smooth correction "
            "by phase and region) name nothing. `screening` names the effect that gains most at "
            "the sizes of a search's first look, if it passes its limit.\n",
            _table(
                (
                    "method",
                    "nulls with a name",
                    "named right from size 20",
                    "gap closed from size 20, median",
                ),
                [
                    (
                        name,
                        _shown(others[name]["false_names"]) if name in others else "-",
                        _shown(others[name]["named_right_from_20"]) if name in others else "-",
                        _of_one(closed.get(name)),
                    )
                    for name in ("recalibration", "black_box", "lasso", "screening", "ours")
                ],
            ),
            "## By hidden law\n",
            _table(
                ("law", "named right", "answers"),
                [
                    (
                        law,
                        _shown(figures["named_right_by_law"][law])
                        if law in figures["named_right_by_law"]
                        else "outside of the library",
                        ", ".join(
                            f"{name} {count}"
                            for name, count in sorted(
                                answers.items(), key=lambda pair: pair[1], reverse=True
                            )
                        ),
                    )
                    for law, answers in figures["confusion"].items()
                ],
            ),
            "## What the halves show\n",
            "The twin's bias, as estimated from each half for the finder before the other half is "
            "searched, and by how much an effect must gain more than all do on simulated nulls "
            "(4 where the data show less).\n",
            _table(
                ("", "first half", "second half"),
                [
                    *(
                        (f"mean of {name}", *(f"{half.get(name, 0.0):.3g}" for half in biases))
                        for name in sorted(set().union(*biases))
                    ),
                    *(
                        (f"factor of {name}", *(f"{half.get(name, 0.0):.3g}" for half in factors))
                        for name in sorted(set().union(*factors))
                        if any(half.get(name, 0.0) > HEAVIER for half in factors)
                    ),
                ],
            ),
            "## From which size on an effect is seen\n",
            "The library's own law, added to presses in which nothing is missing: the size at "
            "which it passes its limit, and its whitened size there; the median of five draws of "
            "eight presses. In the differential mode the same presses are their own commissioning, "
            "without noise of their own, so its limits are those of an instrument that repeats "
            "itself exactly. A dash: not seen within the range.\n",
            _table(
                ("effect", "end of the range", "absolute", "differential"),
                _limit_rows(figures["detection_limits"]),
            ),
            f"Rule version {figures['rule_version']}; {figures['solves']} solves of a press; wrong "
            f"names on nulls: {', '.join(nulls['wrong_names']) or 'none'}.\n",
            entry_list(figures["provenance"]),
        ]
    )
