# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the robot and its gauge, hidden in presses: a whole search names each among what it is
easily taken for.

A bed of springs stands for the gel, of the reality and of the twin: what is tested is whether poses
and forces tell an effect from its neighbours, which takes no finite elements.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spring_gel import open_spring_gel

from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.motion import at_speed, held, joined
from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Recording, recording_of
from dotsim_ros.data.scripted import Site
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.effects.effect import Active
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.simulate import EffectRequest
from dotsim_ros.gap.findings import Findings, Verdict
from dotsim_ros.gap.presses import search
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import lying_cylinder, sphere
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import load_sensor

SENSOR = load_sensor("sensor_a")
SKIN = dome_skin(SENSOR.gel.outer_radius_m, 2.0e-3)
DEVIATION_M, DEVIATION_N = 0.04e-3, 0.015
LIBRARY = load_effects()
# No two are repeats of one protocol, of which one would be held out.
INDENTERS = {
    "ball": sphere(0.004),
    "small_ball": sphere(0.003),
    "roll": lying_cylinder(0.004, 0.012, 1e-3),
    "small_roll": lying_cylinder(0.003, 0.01, 1e-3),
}
# Indenter; tilt, azimuth, spin (degrees); depth (mm).
PRESSES = (
    ("ball", 0, 0, 0, 2.4),
    ("small_ball", 25, 0, 180, 2.0),
    ("roll", 0, 0, 0, 2.0),
    ("small_roll", 20, 60, 90, 1.6),
)


def planned(number: int) -> Recording:
    """Return a press at 30 mm/s that stops, holds for 6 s, slides by 2 mm, and leaves."""
    name, tilt, azimuth, spin, depth_mm = PRESSES[number]
    site = Site(SENSOR.gel.outer_radius_m, *np.deg2rad([tilt, azimuth, spin]))
    top, end = site.pose(-0.6e-3), site.pose(1e-3 * depth_mm)
    down = at_speed([top, end], speed_m_s=0.03)
    across_m = 2e-3 * end.rotation()[:, number % 2]
    beside = replace(end, position_m=end.position_m + across_m)
    off = replace(top, position_m=top.position_m + across_m)
    slide = at_speed([end, beside], speed_m_s=0.01)
    leave = at_speed([beside, off], speed_m_s=0.03)
    motion = joined(down, held(end, 6.0), slide, leave)
    stop_s, slip_s = down.duration_s, down.duration_s + 6.0
    let_go_s = slip_s + slide.duration_s
    time_s = np.concatenate(
        [
            [0.0, 0.4 * stop_s, 0.7 * stop_s],
            stop_s + np.array([0.0, 0.03, 0.06, 0.12, 0.5, 2.0, 6.0]),
            slip_s + slide.duration_s * np.array([0.2, 0.4, 0.7, 1.0]),
            let_go_s + leave.duration_s * np.array([0.3, 1.0]),
        ]
    )
    poses = [motion.at(float(t)) for t in time_s]
    press = Press(f"with_{name}", name, poses, 1.0 + time_s)
    return recording_of(press, INDENTERS[name], SKIN, 20.0 * number)


def measured(folder: Path, *hidden: tuple[str, dict[str, float]]) -> Path:
    """Record the presses with effects; return their data set."""
    recordings = [planned(number) for number in range(len(PRESSES))]
    random = np.random.default_rng(5)
    own = values_of(SENSOR)
    with open_spring_gel(SENSOR, SKIN) as solver:
        # What an arm feels without the effect.
        without = solver.run([EffectRequest(r, own) for r in recordings])
        felt = [
            replace(r, press=replace(r.press, force_n=one.force_n))
            for r, one in zip(recordings, without, strict=True)
        ]
        active = [Active(LIBRARY[name], LIBRARY[name].checked(values)) for name, values in hidden]
        found = solver.run([EffectRequest(r, own, effects=active) for r in felt])
    writer = DataSetWriter(folder / "measured", SKIN)
    for recording, one in zip(recordings, found, strict=True):
        stamp_ns = (1e9 * (recording.session_s + recording.press.stamp_s)).astype(np.int64)
        skin_m = one.skin_position_m + DEVIATION_M * random.standard_normal((SKIN.vertex_count, 3))
        force_n = one.force_n + DEVIATION_N * random.standard_normal(one.force_n.shape)
        channels = Trajectory(
            pose=PoseChannel.of(stamp_ns, recording.press.poses),
            wrench=WrenchChannel(stamp_ns, force_n, np.zeros_like(force_n)),
            skin=SkinChannel(stamp_ns, skin_m.astype(np.float32)),
            name=recording.name,
        )
        writer.add(channels, replace(recording.indenter, name=recording.press.indenter))
    return folder / "measured"


def searched(data: Path, *candidates: str) -> Findings:
    """Return what a search among effects finds, of all where none is given."""
    request = GapRequest(measured=data, sensor=SENSOR, directory=data.parent, candidates=candidates)
    measurement, _ = search.read_measurements(request)
    # Data sets hold meshes, whose distances take longer.
    exact = tuple(replace(r, indenter=INDENTERS[r.press.indenter]) for r in measurement.recordings)
    return search.search_presses(
        request, replace(measurement, recordings=exact), None, lambda *_: None
    )[0]


@pytest.fixture(autouse=True)
def springs_in_place_of_the_gel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "open_solver", open_spring_gel)


@pytest.mark.parametrize(
    ("name", "values", "rival"),
    [
        ("controller_lag", {"lag_s": 0.08, "damping": 0.4}, "latency"),
        ("mount_rotation", {"compliance_rad_nm": 0.02}, "coulomb_slip"),
        ("stage_creep", {"compliance_m_n": 6e-5, "time_s": 2.0}, "viscoelastic_relaxation"),
        ("tool_offset_x", {"x_m": 0.35e-3}, "pose_offset_x"),
        ("tool_tilt_x", {"x_rad": 0.05}, "pose_offset_y"),
        ("force_crosstalk_x", {"share": 0.15}, "force_bias_x"),
    ],
)
def test_an_effect_is_told_from_what_it_is_taken_for(
    tmp_path: Path, name: str, values: dict[str, float], rival: str
) -> None:
    found = searched(measured(tmp_path, (name, values)), name, rival)
    assert (found.verdict, found.named) == (Verdict.NAMED, (name,))
    size, hidden = found.candidates[0].size, next(iter(values.values()))
    # Nuisances take a part of what gives way, and of an offset.
    assert size == pytest.approx(hidden, rel=0.4)
    # What a late slide shows of slip need not be there; what it leaves is.
    assert "left inward after unloading" in {gap.name for gap in found.shear}
