# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags into a LeRobotDataset and back, as the command does it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import msg_adapters
from dotsim_ros.cli.main import main
from dotsim_ros.data.bag import BAG_TYPES, BagFile, BagReader
from dotsim_ros.data.lerobot.bags import IMAGE, POSE, STATE, WRENCH

for package in ("pyarrow", "av"):
    pytest.importorskip(package, reason="needs the extra dataset: pip install '.[dataset]'")

COUNT, PERIOD_NS, SHAPE = 6, 40_000_000, (48, 64, 3)
JOINT_NAMES = ["joint1", "joint2"]


def record(path: Path, seed: int, *, has_arm: bool = True, wrench_shift_ns: int = 0) -> Path:
    """A press as a node and an arm publish it, of odd stamps and numbers."""
    random = np.random.default_rng(seed)
    with BagFile(path) as bag:
        for number in range(COUNT):
            stamp_ns = 1_700_000_000_123_456_789 + number * PERIOD_NS + int(random.integers(999))
            head = {"stamp_ns": stamp_ns, "frame_id": "base", "types": BAG_TYPES}
            image = random.integers(0, 256, SHAPE, dtype=np.uint8)
            quaternion = random.normal(size=4)
            pose = random.normal(size=3), quaternion / np.linalg.norm(quaternion)
            bag.write(
                "/image_raw",
                stamp_ns,
                msg_adapters.encode_image(image, encoding="rgb8", **{**head, "frame_id": "camera"}),
            )
            bag.write("/indenter/state", stamp_ns, msg_adapters.encode_pose_stamped(*pose, **head))
            bag.write(
                "/points", stamp_ns, msg_adapters.encode_cloud(random.normal(size=(5, 3)), **head)
            )
            state = random.normal(size=(2, 2))
            if has_arm:
                joints = msg_adapters.encode_joint_state(JOINT_NAMES, *state, **head)
                bag.write("/arm/joint_states", stamp_ns, joints)
            for shift_ns in {-wrench_shift_ns, 0}:
                head["stamp_ns"] = stamp_ns + shift_ns
                bag.write(
                    "/wrench",
                    stamp_ns + shift_ns,
                    msg_adapters.encode_wrench_stamped(*random.normal(size=(2, 3)), **head),
                )
    return path


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(path) as bag:
        found = bag.messages(*bag.topics())
        return sorted((each.topic, each.log_time_ns, bytes(each.serialized)) for each in found)


@pytest.fixture
def bags(tmp_path: Path) -> list[Path]:
    return [record(tmp_path / f"press{seed}", seed) for seed in (0, 1)]


def convert(*words: object) -> int:
    return main(["convert", *map(str, words)])


def test_a_bag_comes_back_bit_for_bit(bags, tmp_path, capsys):
    assert convert(*bags, "--out", tmp_path / "set") == 0
    said = capsys.readouterr()
    assert said.out == f"{tmp_path / 'set'}: 2 episodes, {2 * COUNT} frames\n"
    assert said.err == ""
    assert convert(tmp_path / "set", "--out", tmp_path / "back") == 0
    for bag, episode in zip(bags, ("episode_000000", "episode_000001"), strict=True):
        assert messages(tmp_path / "back" / episode) == messages(bag)


def test_what_lies_between_frames_is_left_out_and_told(tmp_path, capsys):
    bag = record(tmp_path / "press", 0, has_arm=False, wrench_shift_ns=PERIOD_NS // 2)
    assert convert(bag, "--out", tmp_path / "set") == 0
    assert f"{COUNT} of {2 * COUNT} messages on /wrench lie between" in capsys.readouterr().err
    assert convert(tmp_path / "set", "--out", tmp_path / "back") == 0
    kept = set(messages(tmp_path / "back" / "episode_000000"))
    assert kept < set(messages(bag))
    assert len(kept) == 4 * COUNT


def test_lerobot_reads_it(bags, tmp_path):
    reading = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="lerobot is not installed"
    )
    for images in ("png", "mp4"):
        folder = tmp_path / images
        assert convert(*bags, "--out", folder, "--images", images) == 0
        read = reading.LeRobotDataset("local/press", root=folder)
        assert read.num_episodes == 2
        frame = read[COUNT + 2]
        assert frame["task"] == "touch"
        with BagReader(bags[1]) as bag:
            of = {topic: list(bag.messages(topic)) for topic in bag.topics()}
        force_n, torque_nm = msg_adapters.decode_wrench_stamped(of["/wrench"][2].message())
        assert np.allclose(frame[WRENCH], [*force_n, *torque_nm])
        assert frame[POSE].shape == (7,)
        assert read.meta.features[STATE]["names"] == JOINT_NAMES
        pixels = msg_adapters.decode_image(of["/image_raw"][2].message())
        shown = 255.0 * frame[IMAGE].numpy().transpose(1, 2, 0)
        assert shown.shape == SHAPE
        if images == "png":
            assert np.allclose(shown, pixels, atol=0.01)


def test_a_data_set_of_lerobots_own_becomes_bags(tmp_path, capsys):
    writing = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="lerobot is not installed"
    )
    key, folder, random = "observation.images.wrist", tmp_path / "set", np.random.default_rng(0)
    features = {
        key: {"dtype": "image", "shape": SHAPE, "names": ["height", "width", "channels"]},
        STATE: {"dtype": "float32", "shape": (2,), "names": JOINT_NAMES},
        "action": {"dtype": "float32", "shape": (2,), "names": JOINT_NAMES},
    }
    made = writing.LeRobotDataset.create("local/own", 25, features, folder, use_videos=False)
    images = random.integers(0, 256, (4, *SHAPE), dtype=np.uint8)
    states = random.normal(size=(4, 2)).astype(np.float32)
    for number, (image, state) in enumerate(zip(images, states, strict=True)):
        made.add_frame({key: image, STATE: state, "action": state, "task": "wave"})
        if number % 2:
            made.save_episode()
    made.finalize()
    assert convert(folder, "--out", tmp_path / "bags") == 0
    assert "left out, for lack of a topic: action" in capsys.readouterr().err
    with BagReader(tmp_path / "bags" / "episode_000001") as bag:
        seen = [each.message() for each in bag.messages("/wrist/image_raw/compressed")]
        joints = [each.message() for each in bag.messages("/joint_states")]
    assert [msg_adapters.message_stamp_ns(each) for each in seen] == [0, PERIOD_NS]
    for message, image in zip(seen, images[2:], strict=True):
        assert np.array_equal(msg_adapters.decode_compressed_image(message), image)
    assert [list(each.name) for each in joints] == [JOINT_NAMES] * 2
    assert np.array_equal([each.position for each in joints], states[2:])


@pytest.mark.fault("bags and data sets", "")
def test_what_cannot_be_converted_is_told(bags, tmp_path, capsys, answered):
    def said(what: str, *words: object) -> None:
        assert convert(*words) == 1
        answered(capsys.readouterr().err, what=what)

    out = tmp_path / "set"
    backwards = tmp_path / "backwards"
    with BagFile(backwards) as bag:
        for stamp_ns in (2 * 10**9, 10**9):
            head = {"stamp_ns": stamp_ns, "frame_id": "base", "types": BAG_TYPES}
            image = msg_adapters.encode_image(np.zeros(SHAPE, np.uint8), encoding="rgb8", **head)
            bag.write("/image_raw", 10**9, image)
    said("convert: a clock runs backwards", backwards, "--out", out)
    assert not out.exists()
    assert convert(bags[0], "--out", out) == 0
    capsys.readouterr()
    said("convert: the data set is there already", bags[0], "--out", out)
    info = out / "meta" / "info.json"
    text = info.read_text()
    info.write_text(text.replace('"v3.0"', '"v2.1"'))
    said("convert: a data set of another version", out, "--out", tmp_path / "back")
    info.write_text(json.dumps(json.loads(text) | {"data_path": "../{chunk_index}"}))
    said("convert: a data set whose files are outside of it", out, "--out", tmp_path / "back")
    info.write_text(text.replace('"fps": ', '"fps": -'))
    said("convert: a data set of no valid rate", out, "--out", tmp_path / "back")
    info.write_text(text)
    (frames,) = out.glob("data/*/*.parquet")
    frames.write_bytes(frames.read_bytes()[:-100])
    said("convert: a table that is cut short", out, "--out", tmp_path / "back")
    assert not (tmp_path / "back" / "episode_000000").exists()
