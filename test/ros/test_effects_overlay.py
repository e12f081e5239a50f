# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Found effects at work in the live node: its frames change as the overlay says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from harness import (
    APEX_M,
    LockstepPress,
    TactileFrame,
    sensor,
)

import msg_adapters
from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay, overlay_text

# What effects change does not depend on the grid; a coarse one is made in a tenth of the time.
PARAMETERS = {"clock": "lockstep", "diagnostics_period_s": 0.1, "grid_spacing_m": 0.0048}


def overlay_at(path: Path, effects: Mapping[str, Mapping[str, float]]) -> Path:
    """Write an overlay of effects with their values, without intervals."""
    found = tuple(
        FoundEffect(name, tuple(Estimate(p, "", v, v, v) for p, v in values.items()))
        for name, values in effects.items()
    )
    path.write_text(overlay_text(Overlay("densetact2", "0123456789abcdef", found)))
    return path


@pytest.fixture(scope="module")
def plain() -> list[TactileFrame]:
    """Return the press without effects."""
    with sensor(**PARAMETERS) as (_, client):
        assert client.state("gel").values["effects"] == "none"
        return LockstepPress(client).run()


DIM_GREEN = """
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter

EFFECT = Effect(
    name="dim_green",
    title="Dim green",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, (0.5,)),),
    channels=(IMAGE,),
    protocol="any",
    excited_by=lambda recording: True,
    image=lambda values: lambda image: image.pixels * [1.0, 1.0 - values["share"], 1.0],
)
"""


def test_effects_change_the_frames_and_are_named(tmp_path: Path, plain: list[TactileFrame]) -> None:
    folder, run = tmp_path / "effects", tmp_path / "run"
    folder.mkdir()
    (folder / "dim_green.py").write_text(DIM_GREEN)
    (folder / "other.py").write_text(f"EFFECT = open({str(run)!r}, 'w').close()\n")
    path = overlay_at(
        tmp_path / "effects_overlay.yaml",
        {
            "force_scale": {"scale": 1.1},
            "led_imbalance_red": {"loss_share": 0.2},
            "dim_green": {"share": 0.5},
        },
    )
    with sensor(effects=path, effects_folder=folder, **PARAMETERS) as (executable, client):
        named = "force_scale (scale 1.1), led_imbalance_red (loss_share 0.2), dim_green (share 0.5)"
        assert client.state("gel").values["effects"] == named
        assert f"effects: {named}" in executable.log
        press = LockstepPress(client)
        first, again = press.run(), press.run()
    assert not run.exists(), "a file that the overlay does not name was run"
    assert [a.is_same(b) for a, b in zip(first, again, strict=True)] == [True] * len(first)
    for frame, other in zip(first, plain, strict=True):
        assert frame.force_n() == pytest.approx(1.1 * other.force_n(), rel=1e-12)
        torque_nm, plain_nm = (
            msg_adapters.decode_wrench_stamped(each.messages["wrench"])[1]
            for each in (frame, other)
        )
        assert torque_nm == pytest.approx(1.1 * plain_nm, rel=1e-9, abs=1e-12)
        assert np.array_equal(frame.depth_m(), other.depth_m(), equal_nan=True)
        assert np.array_equal(frame.image(), np.rint([0.8, 0.5, 1.0] * other.image()))


def test_a_gel_that_relaxes_only_by_the_overlay_goes_on_in_real_time(tmp_path: Path) -> None:
    path = overlay_at(
        tmp_path / "effects_overlay.yaml",
        {"viscoelastic_relaxation": {"share": 0.4, "time_s": 0.3}},
    )
    coarse = PARAMETERS["grid_spacing_m"]
    with sensor(effects=path, rate_hz=10.0, grid_spacing_m=coarse) as (_, client):
        deep = [0.0, 0.0, APEX_M - 1e-3]
        client.send(deep)
        arrived = client.next_frame(lambda frame: frame.indenter_m() == pytest.approx(deep))
        peak_n = arrived.force_n()[2]
        client.next_frame(lambda frame: 0.0 < frame.force_n()[2] < 0.9 * peak_n)
