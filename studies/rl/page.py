# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The table of reinforcement learning, and what its figures mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from studies.rl.worlds import AS_LEARNT, WORLDS
from studies.table import Column, markdown_table

COLUMNS = (
    Column("success", "success % ↑", 1, 100.0),
    Column("std", "± between seeds", 1, 100.0),
    Column("least", "worst seed %", 1, 100.0),
    Column("policies", "policies", 0),
    Column("episodes", "episodes of each", 0),
)
SEED_COLUMNS = (
    Column("success", "success % ↑", 1, 100.0),
    Column("frames", "frames to the end", 1),
    Column("steps", "steps learnt", 0),
    Column("minutes", "minutes", 1),
    Column("minutes_to_90", "minutes to 90 %", 1),
)


def rl_page(figures: Mapping[str, Any], curve: str, rollout: str) -> str:
    """Return the page, with links to the pictures."""
    study = figures["study"]
    common = {"policies": study["seeds"], "episodes": study["episodes"]}
    best = figures["best_single_move"]
    rows: list[tuple[list[str], Mapping[str, Any]]] = [
        ([f"PPO, {world}"], {"success": row["mean"], **row, **common})
        for world, row in ((world, figures["success"][world]) for world in WORLDS)
    ]
    blind = {"policies": 1, "episodes": figures["blind_episodes"]}
    rows.append((["random moves"], {"success": figures["random_success"], **blind}))
    rows.append(
        (
            [f"the best single move ({best['name']})"],
            {"success": best["success"][AS_LEARNT], **blind},
        )
    )
    seeds = [
        ([row["name"]], {**row, "success": row["success"][AS_LEARNT]}) for row in figures["learnt"]
    ]
    origin = figures["provenance"]
    options = study["settings"]["options"]
    width, height = options["image_size_px"]
    seen = {"depth": "depth and normals", "image": "the tactile image"}[options["observation"]]
    return "\n".join(
        [
            "# Reinforcement learning: a box turned by touch",
            "",
            "`DenseTactBoxYaw-v0`: the sensor lies across one of two opposite edges of a box; "
            "nine moves in the plane, 24 a second; the box is to be turned to 10 degrees within "
            "a second, an error below 2 degrees counts (paper, section IV-D). Which way to push "
            f"depends on the edge, which only touch tells: {seen}, {width} x {height} pixels. "
            "PPO of skrl, ResNet-18 shared by policy and value, learnt from nothing.",
            "",
            "Judged on episodes whose seeds no training draws; each policy plays its most likely "
            "moves. The worlds after the first were never seen while learning. Nothing was "
            "chosen by these episodes.",
            "",
            markdown_table(["moves"], rows, COLUMNS),
            "",
            "## Each policy",
            "",
            markdown_table(["policy"], seeds, SEED_COLUMNS),
            "",
            *_sweep(figures.get("sweep", ())),
            "Minutes are of one core of the machine named below, which had other work beside it; "
            f"{figures['steps_per_second']} steps a second with learning. The paper states 15 "
            "minutes and no success rate. Minutes to 90 %: until 90 % of the last 50 episodes, "
            "which explore, got there.",
            "",
            f"![success against steps]({curve})",
            "",
            f"![a policy at play, four times slower than the world]({rollout})",
            "",
            "Left: from above, the box blue, its target grey, the sensor orange. Right: the "
            "tactile image.",
            "",
            f"Commit {origin['commit']}, {origin['date']}, {origin['machine']}: "
            f"`{origin['command']}`",
            "",
        ]
    )


def _sweep(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the part about settings that were tried before; empty where none were."""
    if not rows:
        return []
    found = ("success", "steps")
    named = [
        (
            [", ".join(f"{name} {value:g}" for name, value in row.items() if name not in found)],
            {name: row[name] for name in found},
        )
        for row in rows
    ]
    return [
        "## Settings that were tried",
        "",
        "One policy each, of a seed of its own, judged on episodes that no other figure of this "
        "page is of. The policies above learnt with the settings of the best row, the first of "
        "several.",
        "",
        markdown_table(["settings"], named, (SEED_COLUMNS[0], SEED_COLUMNS[2])),
        "",
    ]
