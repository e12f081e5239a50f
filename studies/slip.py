# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Judges a slip detector, trained on simulated touches alone, on slides of independent solvers.

A slide's frame slips as `learning.slip.SkinTouch.slips` says, from measured pose and skin. Of the
sets that independent finite elements solved, `open_none` and `open_friction` were looked at while
the features were chosen; the others are judged once. `open_pair`, whose poses are late, is left
out: its label would be wrong.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.reading import PressReader
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.files import expanded
from dotsim_ros.learning.slip import SkinTouch, SlipDetector, labelled_frames, touches_in
from dotsim_ros.learning.touches.plan import read_plan
from dotsim_ros.learning.touches.run import make_touches
from studies.data import DATA

PLAN = Path(__file__).parents[1] / "examples" / "slip_touches.yaml"
DEVELOPMENT = ("open_none", "open_friction")
HELD_OUT = (
    *("open_none_2", "open_slippery", "open_stiffening", "open_stiff_2"),
    *("open_relaxation", "open_core", "open_debonded"),
)


def slip(*, touches: int = 300, out: Path = Path("out/slip"), data: Path = DATA) -> dict[str, Any]:
    """Judge the slip detector on slides of independent finite elements.

    Args:
        touches: that it learns from.
        out: folder of the touches.
        data: folder of the measured sets.
    """
    plan = read_plan(PLAN)
    make_touches(plan, out, count=touches, kind="webdataset", workers=2, progress=lambda *_: None)
    skin = skin_of(plan.sensor.gel)
    known = list(touches_in(out, skin.rest_position_m))
    detector = SlipDetector(*labelled_frames(known))
    return {
        kind: _score(detector, [slide for name in sets for slide in _slides(data, name, skin)])
        for kind, sets in (("development", DEVELOPMENT), ("held_out", HELD_OUT))
    }


def _slides(data: Path, name: str, own_skin: SkinMesh) -> list[SkinTouch]:
    data_set = read_data_set(expanded(data) / "measured" / name)
    reader = PressReader.of(data_set, own_skin)
    found = []
    for entry in data_set.entries:
        if "slide" in entry.name:
            observation = reader.read(entry)
            press, rest_m = observation.press, reader.skin.rest_position_m
            if press.skin_position_m is None or press.force_n is None:
                raise ValueError(f"{name}, {entry.name}: expected skin and force")
            moved_m = press.skin_position_m - rest_m
            found.append(
                SkinTouch(rest_m, moved_m, press.force_n, press.poses, observation.indenter)
            )
    return found


def _score(detector: SlipDetector, slides: list[SkinTouch]) -> dict[str, Any]:
    features, truth = labelled_frames(slides)
    found = detector(features)
    slipping, sticking = int((found & truth).sum()), int((~found & ~truth).sum())
    shares = slipping / max(truth.sum(), 1), sticking / max((~truth).sum(), 1)
    return {
        "slides": len(slides),
        "frames": len(truth),
        "slips": int(truth.sum()),
        "slips_found": slipping,
        "others_right": sticking,
        "right_percent": round(100.0 * (slipping + sticking) / len(truth), 1),
        "balanced_percent": round(50.0 * float(sum(shares)), 1),
    }
