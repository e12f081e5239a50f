# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Findings of a small dome for tests of reports: made up, one for each verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.findings import (
    Candidate,
    ChannelGap,
    Explanation,
    Findings,
    Pair,
    Question,
    ResidualPlace,
    ShearGap,
    Verdict,
    WorstFrame,
)
from dotsim_ros.geometry.skin_mesh import dome_skin

RADIUS_M = 0.01575
TRAJECTORIES = ("slide_1", "slide_2", "hold_1", "oblique_press_with_a_long_name_1")
PHASES = ("idle", "load", "hold", "slide", "release")
REGIONS = {"skin": ("apex", "contact", "rim", "far", "base"), "force": ("normal", "tangential")}


def places() -> tuple[ResidualPlace, ...]:
    random = np.random.default_rng(1)
    found = []
    for trajectory in (*TRAJECTORIES, "all"):
        for phase in PHASES:
            if phase == "slide" and not trajectory.startswith(("slide", "all")):
                continue
            for channel, regions in REGIONS.items():
                for region in regions:
                    strong = 9.0 if phase == "slide" and region in ("rim", "tangential") else 1.2
                    before = strong * random.uniform(0.8, 1.2)
                    after = min(before, random.uniform(0.8, 1.2))
                    rms = (before, after, 0.8 * before, 1.3 * before)
                    found.append(ResidualPlace(channel, trajectory, phase, region, *rms, count=40))
    return tuple(found)


def worst() -> WorstFrame:
    rest = dome_skin(RADIUS_M, 2.0e-3).rest_position_m
    dent = np.exp(-((np.hypot(rest[:, 0] - 0.003, rest[:, 1]) / 0.004) ** 2))
    depth = np.stack([0.3 * dent, 0.0 * dent, -dent], axis=1)
    skins = [rest + size * depth for size in (0.0, 1.5e-3, 1.2e-3, 1.48e-3)]
    rest_m, measured, before, after = (skin.tolist() for skin in skins)
    forces = [0.4, -0.1, 2.1], [0.2, 0.0, 2.0], [0.39, -0.09, 2.08]
    return WorstFrame("slide_1", 31, 3.1, rest_m, measured, before, after, *forces)


def named() -> Findings:
    ratio = Estimate("friction_ratio", "", 1.52, 1.41, 1.66)
    return Findings(
        Verdict.NAMED,
        "Coulomb slip at another friction is missing: friction_ratio = 1.52 [1.41, 1.66]; "
        "held-out force gap 3.4 -> 1.1 times the floor.",
        named=("coulomb_slip",),
        statistic=212.0,
        threshold=14.6,
        p_value=0.0,
        candidates=(
            Candidate(
                "coulomb_slip",
                "Coulomb slip at another friction",
                True,
                212.0,
                1.6,
                0.93,
                88.0,
                (ratio,),
            ),
            Candidate("pose_offset", "Pose offset", True, 31.0, 0.00012, 0.2, 3.1),
            Candidate("backlash", "Backlash", True, 2.4, 0.00002),
            Candidate("mullins_softening", "Mullins softening", False, 0.0, 0.0),
        ),
        calibrated=(
            Estimate("E", "Pa", 1.9e5, 1.8e5, 2.0e5),
            Estimate("offset_z_m", "m", 2.0e-5, -1.0e-5, 5.0e-5),
        ),
        places=places(),
        shear=(ShearGap("way to the onset of slip", "m", "slide", 8.1e-4, 5.3e-4, 8e-4, 9e-5),),
        gaps=(
            ChannelGap("skin", "m", 0.21e-3, 0.15e-3, 0.052e-3, 0.05e-3),
            ChannelGap("force", "N", 0.31, 0.22, 0.05, 0.04),
        ),
        share_closed=0.96,
        share_closed_low=0.91,
        share_closed_high=0.99,
        stability=0.95,
        worst=worst(),
        warnings=("Mullins softening is not tested: no trajectory repeats a press.",),
        trajectories=TRAJECTORIES[:2],
        locked=TRAJECTORIES[2:],
        solve_count=412,
        seconds=1130.0,
        data_hash="5f1d" * 16,
        sensor="densetact2",
    )


def of_set() -> Findings:
    return replace(
        named(),
        verdict=Verdict.SET,
        sentence="Coulomb slip or a pose offset is missing: these data do not distinguish them.",
        alternatives=("pose_offset",),
        stability=0.6,
        worst=None,
        pairs=(
            Pair("coulomb_slip", "pose_offset", -0.98, 1.4, "slides in two opposite directions"),
        ),
        explanations=(
            Explanation("coulomb_slip", "Coulomb slip at another friction", 0.62),
            Explanation("pose_offset", "pose offset", 0.37),
            Explanation("unknown", "an effect outside the library", 0.01),
        ),
        questions=(
            Question(
                "asked_1_slide",
                "ball",
                "a slide of 4 mm, 2 mm deep, at 5 mm/s at the apex",
                17.0,
                0.52,
                {"pose_offset": 4.1, "unknown": 1.2},
                [0.0, 1.0],
                [[0.0, 0.0, 0.0163, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0138, 0.0, 0.0, 0.0, 1.0]],
            ),
        ),
    )


def unknown() -> Findings:
    return replace(
        named(),
        verdict=Verdict.UNKNOWN,
        sentence="A gap in the force while sliding that no effect of the library explains.",
        named=(),
        share_closed=None,
        share_closed_low=None,
        share_closed_high=None,
        stability=None,
    )


def no_gap() -> Findings:
    return Findings(
        Verdict.NO_GAP,
        "No gap beyond noise and discretisation.",
        statistic=6.1,
        threshold=14.6,
        p_value=0.4,
        candidates=(Candidate("coulomb_slip", "Coulomb slip", True, 6.1, 1.05),),
        places=tuple(replace(p, before=1.0, after=1.0, low=0.0, high=0.0) for p in places()),
        gaps=(ChannelGap("skin", "m", 0.06e-3, 0.05e-3, 0.05e-3, 0.05e-3),),
        trajectories=("slide_1",),
    )


def unusable() -> Findings:
    return Findings(
        Verdict.UNUSABLE,
        "The data cannot be used: no trajectory has poses.",
        warnings=("slide_1: no message on /indenter/pose; record the indenter's poses.",),
    )


def without_skin() -> Findings:
    only_force = replace(
        worst(),
        rest_m=[],
        measured_m=[],
        before_m=[],
        after_m=[],
    )
    return replace(
        named(),
        worst=only_force,
        gaps=named().gaps[1:2],
        places=tuple(place for place in places() if place.channel == "force"),
    )


def without_force() -> Findings:
    only_skin = replace(
        worst(),
        force_measured_n=[],
        force_before_n=[],
        force_after_n=[],
    )
    return replace(
        named(),
        worst=only_skin,
        gaps=named().gaps[:1],
        places=tuple(place for place in places() if place.channel == "skin"),
    )


EXAMPLES = {
    "named": named,
    "set": of_set,
    "unknown": unknown,
    "no_gap": no_gap,
    "unusable": unusable,
    "without_skin": without_skin,
    "without_force": without_force,
}
