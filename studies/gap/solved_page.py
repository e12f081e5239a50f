# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page of the gap finder on effects that finite elements have solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from studies.table import entry_list

_RATES = {
    "nulls_right": "nulls called no gap",
    "nulls_with_a_name": "nulls with a name",
    "single_right": "one effect: named, alone",
    "single_right_or_in_the_set": "one effect: named, or in a set of names",
    "single_wrong_name": "one effect: a wrong name",
    "pairs_both": "two effects: both named",
    "pairs_one_at_least": "two effects: one named at least",
    "pairs_wrong_name": "two effects: a wrong name",
    "outside_called_unknown": "outside the library: called unknown",
    "intervals_that_cover": "intervals that hold the true parameter",
}


def solved_page(figures: Mapping[str, Any]) -> str:
    """Return the figures of `score_sets`, by half, as a Markdown page."""
    parts = [
        "# The gap finder on effects that finite elements have solved\n",
        "The sets are CalculiX's (`dotsim_ros hide`): what is wrong is part of what it solves, and "
        "nothing of our gel takes part. Each set is one unit with eight trajectories, searched "
        "once by `find-gap` with the twin that the command names. Its truth was sealed before. "
        "Intervals of shares are Wilson's, of 95 %.\n",
    ]
    for half, of_half in figures["halves"].items():
        parts += _half(half, of_half)
    return "\n".join(parts)


def _half(half: str, figures: Mapping[str, Any]) -> list[str]:
    series = figures["series"]
    parts = [
        f"## The half {half}\n",
        f"Seed {series['seed']}, {len(figures['sets'])} sets of {series['count']} in both halves; "
        f"{figures['not_ready']} more of this half were not ready; "
        f"{len(figures['failed_trajectories'])} trajectories could not be solved. Made at "
        f"{series['made_at']} with CalculiX {series['calculix']}.\n",
        _table(
            ("", "share"), [(text, _rate(figures["rates"][key])) for key, text in _RATES.items()]
        ),
        "",
        _table(
            ("set", "hidden", "answer", "outcome", "true", "found", "gap closed", "score / limit"),
            [_row(row) for row in figures["sets"]],
        ),
        "",
        entry_list(figures["provenance"]),
    ]
    return parts


def hidden_text(effects: Sequence[Mapping[str, Any]], decoys: Sequence[str]) -> str:
    """Return what was hidden in a set, as text."""
    if not effects:
        return "nothing; decoys: " + ", ".join(decoys)
    return ", ".join(f"{e['name']} {e['size']:.3g} {e['unit']}" for e in effects)


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    hidden = hidden_text(row["hidden"], row["decoys"])
    answer = ", ".join(row["named"]) or row["verdict"].replace("_", " ")
    if row.get("alternatives"):
        answer += " or " + ", ".join(row["alternatives"])
    elif row["verdict"] == "unknown" and row.get("nearest"):
        answer += f"; nearest {row['nearest'][0]}"
    estimates = row.get("estimates", ())
    closed = row.get("share_closed")
    score = f"{row['statistic']:.0f} / {row['threshold']:.0f}" if "statistic" in row else "-"
    outcome = row["outcome"]
    return (
        row["set"],
        hidden,
        answer,
        outcome if outcome == "right" else f"**{outcome}**",
        "; ".join(f"{e['true']:.3g}" for e in estimates) or "-",
        "; ".join(
            f"{e['found']:.3g} [{e['low']:.3g}, {e['high']:.3g}]" + ("" if e["covers"] else " no")
            for e in estimates
        )
        or "-",
        "-" if closed is None else f"{closed:.0%}",
        score,
    )


def _rate(rate: Mapping[str, Any]) -> str:
    if rate["of"] == 0:
        return "no case"
    return f"{rate['share']:.0%} [{rate['low']:.0%}, {rate['high']:.0%}] of {rate['of']}"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [" | ".join(header), " | ".join("---" for _ in header)]
    lines += [" | ".join(row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)
