# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cloning an expert: examples, a training that can be broken off, and its files."""

from __future__ import annotations

import shutil
from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest

from dotsim_ros.cli.main import main
from dotsim_ros.control.policy.demonstration import (
    CARD,
    Episode,
    episode_file,
    labels,
    read_episode,
    write_episode,
)
from dotsim_ros.control.policy.examples import (
    LEAST_WEIGHT,
    PolicyExamples,
    data_hash,
    exposed,
    frames_of,
    read_split,
)
from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.control.policy.paths import DomeContact, Expert, reference_path
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import write_json

torch = pytest.importorskip("torch", reason="training needs the extra learning")

CONTACT = DomeContact()
PATHS = ("line", "press")
SIDE = 48


def drawn_episode(seed: int, count: int = 12) -> Episode:
    """Return an episode whose crops show a spot where the contact is."""
    random = np.random.default_rng(seed)
    tilt = random.uniform(-0.35, 0.35, (count, 2))
    depth = random.uniform(0.5e-3, 2.0e-3, count)
    position = CONTACT.position_m(tilt, depth)
    idle = random.integers(60, 160, (1, SIDE, SIDE, 3), dtype=np.uint8)
    crops = []
    for place, deep in zip(tilt, depth, strict=True):
        x, y = np.rint(SIDE / 2 + SIDE * place).astype(int)
        crop = idle[0].copy()
        cv2.circle(crop, (int(x), int(y)), 1 + round(2e3 * deep), (250, 250, 250), -1)
        crops.append(crop)
    return Episode(
        np.array([crops]),
        idle,
        random.standard_normal((1, count, 96), dtype=np.float32),
        position,
        labels(PATHS, CONTACT, position),
        PATHS,
    )


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    """A folder of three episodes."""
    folder = tmp_path_factory.mktemp("demonstrations")
    for number in range(3):
        write_episode(episode_file(folder, number), drawn_episode(number))
    write_json(
        folder / CARD,
        {
            "plan": {"paths": list(PATHS), "sensor": "densetact2", "indenter": "sphere_4mm"},
            "rate_hz": 25.0,
            "view": {"image_shape": [480, 640], "share": 0.7, "side_px": SIDE},
            "contact": asdict(CONTACT),
            "content": "of the sensor",
        },
    )
    return folder


def with_card(demonstrations, folder, **changed):
    """Return a folder of the same episodes, whose card has other entries; None for none."""
    shutil.copytree(demonstrations, folder)
    card = read_json(folder / CARD) | changed
    write_json(folder / CARD, {name: value for name, value in card.items() if value is not None})
    return folder


def trained(folders, out, example_count=4, progress=print):
    """Return the report of a short training."""
    from dotsim_ros.control.policy.training import train_policy

    return train_policy(
        folders,
        out / "policy",
        record=out / "record",
        name="drawn",
        recipe=recipe(example_count),
        seed=0,
        progress=progress,
    )


def test_an_episode_is_read_as_it_was_written(tmp_path):
    episode = drawn_episode(4)
    path = episode_file(tmp_path, 3)
    write_episode(path, episode)
    read = read_episode(path)
    np.testing.assert_array_equal(read.crop, episode.crop)
    np.testing.assert_array_equal(read.command, episode.command)
    assert read.paths == PATHS
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ValueError, match="holds no demonstration"):
        read_episode(path)


def test_whole_episodes_are_held_out(demonstrations):
    train, held_out = read_split([demonstrations])
    assert (len(train), len(held_out)) == (24, 12)
    np.testing.assert_array_equal(held_out.position_m, drawn_episode(2).position_m)
    assert set(train.idle_of) == {0, 1}


def test_folders_of_other_paths_or_another_sensor_of_the_same_name_are_refused(
    demonstrations, tmp_path
):
    plan = {"paths": ["arc"], "sensor": "densetact2", "indenter": "sphere_4mm"}
    other = with_card(demonstrations, tmp_path / "other", plan=plan)
    assert data_hash([demonstrations]) != data_hash([other])
    same_name = with_card(demonstrations, tmp_path / "sensor", content="of another sensor")
    for folder in (other, same_name):
        with pytest.raises(ValueError, match="same paths, sensor and indenter"):
            read_split([demonstrations, folder])
    with pytest.raises(ValueError, match="dotsim_ros demonstrate"):
        read_split([tmp_path / "nothing"])


def test_the_key_is_of_what_the_episodes_hold(demonstrations, tmp_path):
    """A file of other images, places and commands has the same size."""
    same = with_card(demonstrations, tmp_path / "same")
    assert data_hash([same]) == data_hash([demonstrations])
    path = episode_file(same, 1)
    before, episode = path.stat().st_size, read_episode(path)
    write_episode(
        path,
        replace(
            episode,
            crop=255 - episode.crop,
            position_m=-episode.position_m,
            command=-episode.command,
        ),
    )
    assert path.stat().st_size == before
    assert data_hash([same]) != data_hash([demonstrations])


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"contact": None}, "has no contact.*another folder"),
        ({"content": None}, "has no content.*another folder"),
        ({"contact": []}, r"contact is .*expected dome_radius_m and ball_radius_m"),
        ({"contact": {"dome_radius_m": 0.01, "ball_radius_m": "4 mm"}}, r"contact is .*expected"),
    ],
)
def test_a_card_that_does_not_note_its_dome_is_refused(demonstrations, tmp_path, changed, reason):
    folder = with_card(demonstrations, tmp_path / "before", **changed)
    with pytest.raises(ValueError, match=reason):
        trained([folder], tmp_path)


def test_answers_are_the_experts_and_count_where_the_path_is_near():
    examples = PolicyExamples(frames_of([drawn_episode(0)]), PATHS, CONTACT, SIDE)
    path = reference_path("line", CONTACT)
    places = np.stack([path.position_m[10], path.position_m[10] + [0.0, 0.0, 1.5e-3]])
    commands, weight, place = examples.answers(places)
    np.testing.assert_allclose(commands[:, 0], Expert(path).command(places))
    assert weight[0, 0] == pytest.approx(1.0)
    assert weight[1, 0] == pytest.approx(0.5, abs=0.1)
    assert weight[:, 1].max() < 2.0 * LEAST_WEIGHT
    assert place.shape == (2, 3)


def test_a_batch_turns_crops_and_answers_together():
    """The spot in each input lies where its answer's place says."""
    examples = PolicyExamples(frames_of([drawn_episode(1, count=40)]), PATHS, CONTACT, SIDE)
    random = np.random.default_rng(0)
    crops, commands, weight, place = examples.batch(np.arange(40), random)
    assert commands.shape == (40, 2, 6)
    assert weight.shape == (40, 2)
    change = np.clip(crops[:, :3].sum(axis=1), 0.0, None) ** 2
    line = np.arange(SIDE) - SIDE / 2 + 0.5
    total = change.sum(axis=(1, 2))
    found = np.stack(
        [(change.sum(axis=1) * line).sum(axis=1), (change.sum(axis=2) * line).sum(axis=1)], axis=1
    )
    error = found / total[:, None] - SIDE * 0.25 * place[:, :2]
    assert np.median(np.abs(error)) < 1.0


def test_a_new_exposure_changes_both_crops_alike():
    random = np.random.default_rng(1)
    idle = np.full((32, 32, 3), 120, dtype=np.uint8)
    now, before = exposed(idle, idle, random)
    assert now.dtype == before.dtype == np.uint8
    assert not np.array_equal(before, idle)
    np.testing.assert_allclose(now.mean(axis=(0, 1)), before.mean(axis=(0, 1)), rtol=0.05)


def recipe(count: int):
    from dotsim_ros.control.policy.training import PolicyRecipe

    return PolicyRecipe(example_count=count, batch=2, side_px=SIDE)


def weights_of(training):
    return {name: value.clone() for name, value in training.network.state_dict().items()}


@pytest.mark.fault("networks and cards", "a broken state of an interrupted training")
def test_a_training_that_was_broken_off_goes_on_as_if_it_had_not(
    demonstrations, tmp_path, monkeypatch, caplog, answered
):
    from dotsim_ros.control.policy import training as policy_training

    monkeypatch.setattr(policy_training, "ROUND", 4)
    frames = read_split([demonstrations])[0]
    examples = PolicyExamples(frames, PATHS, CONTACT, SIDE)

    def training(folder, count=8):
        return policy_training.PolicyTraining(
            examples, 2, recipe(count), seed=3, key="key", checkpoint=tmp_path / folder / "state.pt"
        )

    whole = training("whole")
    reported = []
    whole.run(reported.append)
    assert [progress.done for progress in reported] == [4, 8]

    class BrokenOffError(Exception):
        pass

    def stop(progress):
        raise BrokenOffError

    with pytest.raises(BrokenOffError):
        training("parts").run(stop)
    second = training("parts")
    assert second.done == 4
    second.run(reported.append)
    for name, value in weights_of(whole).items():
        assert torch.equal(value, weights_of(second)[name]), name

    with pytest.raises(ValueError, match="other data"):
        training("parts", count=16)
    (tmp_path / "parts" / "state.pt").write_bytes(b"nothing")
    caplog.clear()
    assert training("parts").done == 0
    assert (tmp_path / "parts" / "state.pt.kept").read_bytes() == b"nothing"
    (line,) = [record.getMessage() for record in caplog.records]
    assert "kept as state.pt.kept, and training begins again" in line
    assert "weights_only" not in line
    assert "pickle" not in line
    answered(line)


def test_training_judges_and_writes_a_policy(demonstrations, tmp_path):
    reported = []
    report = trained([demonstrations], tmp_path, 8, reported.append)
    assert reported[-1].done == 8
    assert set(report["card"]["metrics"]) >= {"place_sideways_m", "place_depth_m"}
    policy = load_policy(tmp_path / "policy", "press")
    assert policy.card.data["train_images"] == 24
    idle = np.full((480, 640, 3), 100, dtype=np.uint8)
    assert np.all(np.isfinite(policy(idle, idle)))


def test_a_training_that_diverges_is_one_line(demonstrations, tmp_path, capsys):
    out = str(tmp_path / "policy")
    given = ["--data", str(demonstrations), "--out", out, "--examples", "64", "--size", "32"]
    assert main(["train-policy", *given, "--learning-rate", "1e30"]) == 1
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "dotsim_ros train-policy: the training diverged after 64 examples; lower the learning rate"
    ]


def test_a_recipe_without_a_batch_is_refused():
    with pytest.raises(ValueError, match="batch"):
        recipe(1)
