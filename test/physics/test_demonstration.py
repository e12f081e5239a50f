# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Demonstrations on the real gel, and a roll-out that closes the loop over its images."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from work_here import open_pool_here

from dotsim_ros.cli.main import main
from dotsim_ros.control.policy.demonstration import (
    CARD,
    DEPTHS_M,
    Demonstrator,
    Plan,
    approach,
    content_of,
    demonstrate,
    episode_file,
    motion_of,
    read_episode,
)
from dotsim_ros.control.policy.examples import moved_crop, moved_position
from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.control.policy.paths import PATHS, DomeContact, reference_path
from dotsim_ros.control.policy.rollout import APPROACH_S, follow
from dotsim_ros.geometry.indenter import box, load_indenter, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import parameter_path
from dotsim_ros.io.worker_pool import pool
from dotsim_ros.optics import pattern
from dotsim_ros.specification import load_sensor

SENSOR = load_sensor("densetact2")
# An episode is made in the same way of any gel; this one takes a tenth of the time.
COARSE = replace(SENSOR, solver=replace(SENSOR.solver, refined=False, grid_spacing_m=3.6e-3))
BALL = load_indenter("sphere_4mm")
PLAN = Plan(sensor="densetact2", paths=PATHS, episode_count=2, frame_count=12, look_count=2)


@pytest.fixture(scope="module", autouse=True)
def quick_looks():
    """Make episodes here, with coats whose grain is as coarse as their blotches: to draw a fine one
    takes longer than all frames."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "open_worker_pool", open_pool_here)
        patch.setattr(pattern, "GRAIN_SHARE", 1.0)
        patch.setattr(pattern, "SUPERSAMPLING", 1)
        yield


@pytest.fixture(scope="module")
def sensor():
    """The sensor as it ships under the ball; reset it before use."""
    from dotsim_ros.sensor import TactileSensor

    return TactileSensor(SENSOR, indenter=BALL)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder of two short episodes."""
    folder = tmp_path_factory.mktemp("demonstrations")
    demonstrate(COARSE, BALL, PLAN, folder, progress=lambda done, count: None)
    return folder


def test_motions_stay_where_the_ball_may_be_and_differ():
    contact = DomeContact()
    plan = Plan(sensor="densetact2", paths=PATHS, episode_count=8, frame_count=200)
    kinds, motions = zip(*(motion_of(plan, number, contact) for number in range(8)), strict=True)
    assert sorted(kinds) == sorted([*PATHS, *["wander"] * 4])
    for motion in motions:
        assert motion.shape == (200, 3)
        tilt, depth = contact.tilt_and_depth(motion)
        assert np.linalg.norm(tilt, axis=1).max() < 0.48
        assert depth.min() > DEPTHS_M[0] - 1e-9
        assert depth.max() < DEPTHS_M[1] + 1e-9
        assert np.linalg.norm(np.diff(motion, axis=0), axis=1).max() < 0.7e-3
    np.testing.assert_array_equal(motions[1], motion_of(plan, 1, contact)[1])
    assert not np.array_equal(motions[1], motions[3])


def test_an_episode_shows_the_contact_where_the_ball_is(made):
    episode = read_episode(episode_file(made, 0))
    looks, frames, side = episode.crop.shape[:3]
    assert (looks, frames) == (2, 12)
    assert episode.command.shape == (12, 4, 6)
    assert episode.fingerprint.shape == (2, 12, 96)
    contact = DomeContact()
    tilt, depth = contact.tilt_and_depth(episode.position_m)
    deep = int(np.argmax(depth))
    camera_height = SENSOR.camera.position_m[2]
    for look in range(looks):
        change = np.abs(episode.crop[look, deep].astype(float) - episode.idle[look]).sum(axis=2)
        rows, columns = np.mgrid[0:side, 0:side]
        weight = change**2
        found = np.array([np.average(columns, weights=weight), np.average(rows, weights=weight)])
        # Where the camera sees the middle of the contact, from 0.56 of 86 degrees each way.
        tip = contact.dome_radius_m * tilt[deep]
        angle = np.arctan2(np.linalg.norm(tip), contact.dome_radius_m - camera_height)
        expected = (side - 1) / 2 + side / 2 * np.degrees(angle) / 48.2 * tip / np.linalg.norm(tip)
        assert np.linalg.norm(found - expected) < 0.1 * side


def test_a_run_that_was_broken_off_makes_what_is_missing(made):
    first, second = episode_file(made, 0), episode_file(made, 1)
    kept, before = first.stat().st_mtime_ns, read_episode(second)
    second.unlink()
    count = demonstrate(COARSE, BALL, PLAN, made, progress=lambda done, count: None)
    assert count == 48
    assert first.stat().st_mtime_ns == kept
    again = read_episode(second)
    np.testing.assert_array_equal(again.position_m, before.position_m)
    np.testing.assert_array_equal(again.crop, before.crop)


SAME_NAMES = {
    "gel": (replace(COARSE, gel=replace(COARSE.gel, outer_radius_m=0.0155)), BALL),
    "image": (replace(COARSE, camera=replace(COARSE.camera, idle_image="")), BALL),
    "ball": (COARSE, replace(sphere(0.0038), name=BALL.name)),
}


def test_another_plan_sensor_or_ball_is_not_mixed_in(made, capsys):
    before = (made / CARD).read_bytes()
    assert main(["demonstrate", "--episodes", "2", "--frames", "20", "--out", str(made)]) == 1
    assert "another plan" in capsys.readouterr().err
    for sensor, ball in SAME_NAMES.values():
        with pytest.raises(ValueError, match=r"another sensor or indenter.*--out"):
            demonstrate(sensor, ball, PLAN, made, progress=lambda done, count: None)
    assert (made / CARD).read_bytes() == before


def test_where_the_images_of_a_sensor_lie_makes_it_no_other(tmp_path):
    source = parameter_path(SENSOR.camera.idle_image)
    for path in (source, source.with_suffix(".yaml")):
        shutil.copy(path, tmp_path / path.name)
    image = tmp_path / source.name
    moved = replace(COARSE, camera=replace(COARSE.camera, idle_image=str(image)))
    assert content_of(moved, BALL) == content_of(COARSE, BALL)
    image.with_suffix(".yaml").write_text("lighting: {ambient_fraction: 0.3}", encoding="utf-8")
    assert content_of(moved, BALL) != content_of(COARSE, BALL)


OWN_DOME = """
name: my_dome
gel: {shape: dome, outer_radius_m: 0.014, core_radius_m: 0.005, skin_spacing_m: 0.001}
solver: {grid_spacing_m: 0.0036, refined: false, tolerance_m: 0.0001, iterations: 3}
camera: {width: 160, height: 120, principal_point_px: [79.5, 59.5], idle_image: ""}
"""


def test_a_policy_is_trained_for_a_sensor_and_a_ball_of_ones_own(tmp_path, monkeypatch, capsys):
    pytest.importorskip("torch", reason="training needs the extra learning")
    from dotsim_ros.control.policy import examples, training

    monkeypatch.chdir(tmp_path)
    Path("dome.yaml").write_text(OWN_DOME, encoding="utf-8")
    Path("ball.yaml").write_text("kind: sphere\nradius_m: 0.003\n", encoding="utf-8")
    asked = "--sensor dome.yaml --indenter ball.yaml --paths press --episodes 2 --frames 10"
    assert main(["demonstrate", *asked.split(), "--looks", "1", "--out", "made"]) == 0
    assert read_json(Path("made") / CARD)["contact"] == {
        "dome_radius_m": 0.014,
        "ball_radius_m": 0.003,
    }
    taught = []

    class Watched(examples.PolicyExamples):
        def answers(self, position_m):
            answers = super().answers(position_m)
            taught.append((position_m, answers[0]))
            return answers

    monkeypatch.setattr(training, "PolicyExamples", Watched)
    # test_policy_training.py writes policies: half of the time is spent on the graph.
    monkeypatch.setattr(training, "save_policy", lambda _out, _network, card, **_: card)
    given = "train-policy --data made --examples 32 --size 32 --out policy"
    assert main(given.split()) == 0
    # Those of the episode that is held out, in its order, are what the expert said there.
    held_out = read_episode(episode_file(Path("made"), 1))
    position_m, commands = taught[-1]
    np.testing.assert_array_equal(position_m, held_out.position_m)
    np.testing.assert_allclose(commands, held_out.command)
    assert "the policy is in policy" in capsys.readouterr().out


def test_a_sensor_or_indenter_without_paths_is_refused():
    with pytest.raises(ValueError, match="ball"):
        Demonstrator(SENSOR, box([0.01, 0.01, 0.01]), PLAN)


def test_the_shipped_policy_follows_its_path_by_touch(sensor):
    name = "figure_eight"
    sensor.reset()
    contact = DomeContact()
    policy = load_policy(parameter_path("policies/densetact2_sphere"), name)
    path = reference_path(name, contact)
    start = path.position_m[300] + np.array([0.3e-3, -0.3e-3, 0.0])
    for place in approach(start, contact):
        sensor.press(Pose(place), 0.04)
    places, ended = follow(
        policy,
        lambda pose: sensor.step(pose, 0.04).image,
        sensor.idle_image,
        Pose(start),
        frame_count=75,
        rate_hz=policy.rate_hz,
    )
    assert not ended
    judged = places[round(policy.rate_hz * APPROACH_S) :]
    assert path.nearest(judged)[0].mean() < 0.5e-3
    assert path.laps(judged) > 0.6 * (len(judged) - 1) / policy.rate_hz / path.lap_s


def test_turning_a_crop_is_turning_the_sensor(sensor):
    """What training takes for granted: the turned crop is what the turned place gives."""
    from dotsim_ros.control.policy.images import PolicyView

    view = PolicyView(side_px=48)
    contact = DomeContact()
    depths = {}
    place = contact.position_m([0.2, 0.1], 1.5e-3)
    for symmetry in (0, 1, 6):
        sensor.reset()
        frame = sensor.step(Pose(moved_position(place, symmetry)), 0.04)
        # From 8 mm to 16 mm of depth.
        grey = np.clip(3e4 * (np.nan_to_num(frame.depth_m) - 0.008), 0.0, 255.0).astype(np.uint8)
        depths[symmetry] = view.crop(np.repeat(grey[..., None], 3, axis=2)).astype(int)
    for symmetry in (1, 6):
        expected = moved_crop(depths[0].astype(np.uint8), symmetry).astype(int)
        change = np.abs(depths[0] - depths[symmetry])
        assert change.max() > 25
        assert np.abs(expected - depths[symmetry]).max() < 0.2 * change.max()
