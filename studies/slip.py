# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Judges a slip detector, trained on simulated touches alone, on slides of independent solvers.

A slide's frame slips as `learning.slip.SkinTouch.slips` says, from measured pose and skin. Of the
sets that independent finite elements solved, `open_none` and `open_friction` were looked at while
the features were chosen; the others are held out. `open_pair`, whose poses are late, is left out:
its label would be wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
from studies.run import FAILED

PLAN = Path(__file__).parents[1] / "examples" / "slip_touches.yaml"
DEVELOPMENT = "measured/open_none", "measured/open_friction"
HELD_OUT = (
    *("measured/open_none_2", "measured/open_slippery", "measured/open_stiffening"),
    *("measured/open_stiff_2", "measured/open_relaxation", "measured/open_core"),
    *("measured/open_debonded", "hidden_17/*", "hidden_23/*"),
)
LEAST_RIGHT_PERCENT = 90.0


def slip(
    *,
    touches: int = 300,
    out: Path = Path("out/slip"),
    data: Path = DATA,
    series: Path = Path("data"),
) -> dict[str, Any]:
    """Judge the slip detector on slides of independent finite elements.

    Args:
        touches: that it learns from.
        out: folder of the touches.
        data: folder of the measured sets.
        series: folder of `hidden_17` and `hidden_23`.
    """
    plan = read_plan(PLAN)
    make_touches(plan, out, count=touches, kind="webdataset", workers=2, progress=lambda *_: None)
    skin = skin_of(plan.sensor.gel)
    known = list(touches_in(out, skin.rest_position_m))
    detector = SlipDetector(*labelled_frames(known))
    folders = expanded(data), expanded(series)
    scores = {
        kind: _score(detector, [slide for name in sets for slide in _slides(folders, name, skin)])
        for kind, sets in (("development", DEVELOPMENT), ("held_out", HELD_OUT))
    }
    right = scores["held_out"]["right_percent"]
    failed = [f"{right} % of the held-out frames are right"] if right < LEAST_RIGHT_PERCENT else []
    return {**scores, FAILED: failed}


def _slides(folders: Sequence[Path], name: str, own_skin: SkinMesh) -> Iterator[SkinTouch]:
    sets = [
        path.parent for folder in folders for path in sorted(folder.glob(f"{name}/dataset.yaml"))
    ]
    if not sets:
        raise FileNotFoundError(f"no {name} below {' or '.join(map(str, folders))}")
    for place in sets:
        data_set = read_data_set(place)
        reader = PressReader.of(data_set, own_skin)
        for entry in data_set.entries:
            if "slide" in entry.name:
                observation = reader.read(entry)
                press, rest_m = observation.press, reader.skin.rest_position_m
                if press.skin_position_m is None or press.force_n is None:
                    raise ValueError(f"{place}, {entry.name}: expected skin and force")
                moved_m = press.skin_position_m - rest_m
                yield SkinTouch(rest_m, moved_m, press.force_n, press.poses, observation.indenter)


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
