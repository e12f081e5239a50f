# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gap finder on a real recording that was altered by a known amount, and on a repeat of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.real.altered import CYLINDERS, cylinders

DATA = Path(__file__).parents[3] / "shared" / "real" / "ecoflex_compression"


@pytest.mark.skipif(not DATA.is_dir(), reason="the published sets are not here")
def test_a_scaled_real_force_is_named_and_a_repeat_is_not(tmp_path: Path) -> None:
    chosen = [one for one in CYLINDERS if one.name in ("nothing", "force x 1.2")]
    repeat, scaled = cylinders(
        DATA, tmp_path / "made", 1, ("base_compliance", "force_scale", "pose_offset"), chosen
    )
    assert repeat["verdict"] == "no_gap"
    assert scaled["named"] == "force_scale"
    assert scaled["low"] < scaled["size"] < scaled["high"]
    assert scaled["size"] == pytest.approx(1.2, abs=0.05)
