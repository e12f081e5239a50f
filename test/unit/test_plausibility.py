# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured presses that cannot be what they say are refused; those with faults that sensors have
pass, for the fit and the gap finder to see."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from dotsim_ros.data import reading
from dotsim_ros.data.bag import BagFile, BagReader
from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.measurement import read_measurement
from dotsim_ros.data.plausibility import check_same_shape
from dotsim_ros.data.reading import (
    BadBagError,
    PressReader,
    read_bag,
    read_press_images,
)
from dotsim_ros.data.trajectory import (
    ImageChannel,
    PoseChannel,
    SkinChannel,
    Topics,
    Trajectory,
    WrenchChannel,
)
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin, flat_pad_skin
from studies.hidden.laws import LAWS, LawAnswer, LawMotion

Array = NDArray[np.float64]

RADIUS_M, BALL_M = 0.01575, 0.004
SKIN = dome_skin(RADIUS_M, 1.5e-3)
BALL = sphere(BALL_M)
MODULUS_PA = 2.0e5
DEPTH_M = np.array([-3.0, -0.1, 0.5, 1.2, 2.0, 2.4, 2.4, 1.0, -0.1]) * 1e-3
STAMP_NS = 10_000_000_000 + 300_000_000 * np.arange(len(DEPTH_M))


def press(modulus_pa: float = MODULUS_PA, *, share: float = 1.0) -> Trajectory:
    """Return a press of a ball at the apex, to a share of the depth: Hertz's force, a round dent,
    noise."""
    random = np.random.default_rng(0)
    depth = share * np.maximum(DEPTH_M, 0.0)
    radius = 1.0 / (1.0 / RADIUS_M + 1.0 / BALL_M)
    load = 4.0 / 3.0 * modulus_pa / 0.75 * np.sqrt(radius) * depth**1.5
    force = np.stack([0.0 * load, 0.0 * load, load], axis=1)
    force += 0.015 * random.standard_normal(force.shape)
    rest = SKIN.rest_position_m
    dent = np.exp(-np.sum(rest[:, :2] ** 2, axis=1) / (2.0 * 0.003**2))
    skin = np.repeat(rest[None], len(depth), axis=0)
    skin[:, :, 2] -= depth[:, None] * dent
    skin += 0.04e-3 * random.standard_normal(skin.shape)
    height = RADIUS_M - np.where(DEPTH_M > 0.0, depth, DEPTH_M)
    position = np.stack([0.0 * height, 0.0 * height, height], axis=1)
    return Trajectory(
        pose=PoseChannel(STAMP_NS, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(depth), 1))),
        wrench=WrenchChannel(STAMP_NS, force, np.zeros_like(force)),
        skin=SkinChannel(STAMP_NS, skin.astype(np.float32)),
        name="press",
    )


def forces(change: Callable[[Array], Array]) -> Callable[[Trajectory], Trajectory]:
    def changed(good: Trajectory) -> Trajectory:
        return replace(good, wrench=replace(good.wrench, force_n=change(good.wrench.force_n)))

    return changed


def skins(change: Callable[[Array], Array]) -> Callable[[Trajectory], Trajectory]:
    def changed(good: Trajectory) -> Trajectory:
        moved = np.ascontiguousarray(change(good.skin.position_m)).astype(np.float32)
        return replace(good, skin=replace(good.skin, position_m=moved))

    return changed


def framed(channel: str, frame_id: str) -> Callable[[Trajectory], Trajectory]:
    return lambda good: replace(
        good, **{channel: replace(getattr(good, channel), frame_id=frame_id)}
    )


def later(channel: str, delay_s: float) -> Callable[[Trajectory], Trajectory]:
    return lambda good: replace(
        good, **{channel: replace(getattr(good, channel), stamp_ns=STAMP_NS + int(1e9 * delay_s))}
    )


def turned_over(good: Trajectory) -> Trajectory:
    """Return the press with indenter frames whose +z points into the gel."""
    assert good.pose is not None
    over = np.tile([1.0, 0.0, 0.0, 0.0], (len(STAMP_NS), 1))
    return replace(good, pose=replace(good.pose, quaternion_xyzw=over))


REFUSED: dict[str, tuple[Callable[[Trajectory], Trajectory], str]] = {
    "a force of zero": (
        forces(np.zeros_like),
        r"/indenter/wrench: at 2\.4 mm .*the force is 0 N, the same as in every other frame",
    ),
    "a reversed force": (forces(np.negative), r"pulls the indenter into the gel.*reverse the sign"),
    "an indenter's +z into the gel": (turned_over, r"turn the indenter's frame so that \+z"),
    "a force in mN": (forces(lambda f: 1e3 * f), r"expected newtons and at most 500.*millinewtons"),
    "a light press in mN": (
        lambda _: forces(lambda f: 1e3 * f)(press(share=0.3)),
        r"/indenter/wrench: at 0\.7 mm.*e\+08 Pa.*if these are millinewtons, convert",
    ),
    "a force in kN": (
        forces(lambda f: 1e-3 * f),
        r"e\+02 Pa; expected newtons and 2e\+03 to 2e\+07 Pa; if these are kilonewtons, convert",
    ),
    "a gauge that was not set to zero": (
        forces(lambda f: f + np.array([0.0, 0.0, 4.0])),
        r"wrench, frame 0: a force of 4\.01 N where the indenter is .* mm off the skin.*in air",
    ),
    "forces of another press": (
        forces(lambda f: f[np.array([0, 5, 4, 2, 1, 3, 2, 1, 6])]),
        r"does not follow the press: its correlation .* one clock",
    ),
    "a force frame ft_sensor": (
        framed("wrench", "ft_sensor"),
        r"/indenter/wrench, message 0: frame_id is 'ft_sensor', expected 'densetact_base'",
    ),
    "a pose frame world": (framed("pose", "world"), r"'base_frame: world' to dataset\.yaml"),
    "a skin frame camera": (framed("skin", "camera"), r"/tactile/skin, message 0: frame_id is"),
    "skin vertices in reverse": (
        skins(lambda x: x[:, ::-1]),
        r"/tactile/skin, frame 0: \d+ % of the points lie more than .*order of skin_mesh\.npz",
    ),
    "a skin turned by a quarter": (
        skins(lambda x: x @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
        r"in the sensor's base frame",
    ),
    "a skin that stays at rest": (
        skins(lambda x: np.repeat(SKIN.rest_position_m[None], len(x), axis=0)),
        r"/tactile/skin: no point moves more than 0\.00 mm while the tip goes 2\.4 mm deep",
    ),
    "a skin in millimetres": (
        skins(lambda x: 1e3 * x),
        r"/tactile/skin, message 0: .*multiply by 0\.001",
    ),
    "a skin without two of its points": (
        skins(lambda x: x[:, 2:]),
        r"/tactile/skin, message 0: .*record the vertices",
    ),
    "no poses": (
        lambda good: replace(good, pose=None),
        r"no message on /indenter/pose.*record the indenter's poses",
    ),
    "poses alone": (
        lambda good: replace(good, wrench=None, skin=None),
        r"neither /tactile/skin nor /indenter/wrench.*record one",
    ),
    "a force in one frame alone": (
        lambda good: replace(
            good, wrench=WrenchChannel(STAMP_NS[:1], np.ones((1, 3)), np.zeros((1, 3)))
        ),
        r"1 stamps of the wrench differ from the 9 of the pose.*record one pose with each",
    ),
    "forces stamped 3 s later": (
        later("wrench", 3.0),
        r"every stamp of the wrench is 3 s after that of its pose.*two clocks",
    ),
    "a skin stamped 2 s earlier": (
        later("skin", -2.0),
        r"every stamp of the skin is 2 s before that of its pose",
    ),
}


CASES = tuple(REFUSED.values())


def written(folder: Path, trajectory: Trajectory) -> DataSet:
    return write_data_set(folder / "data", [(trajectory, BALL)], skin=SKIN)


def read(data_set: DataSet, *, has_vertices: bool = True) -> None:
    (entry,) = data_set.entries
    PressReader(data_set, SKIN, has_vertices).read(entry)


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    presses = [replace(change(press()), name=f"press {k}") for k, (change, _) in enumerate(CASES)]
    folder = tmp_path_factory.mktemp("refused") / "data"
    # Of the writer's skin no press may lack a point.
    data_set = write_data_set(folder, [(one, BALL) for one in presses])
    skin = {name: getattr(SKIN, name) for name in ("rest_position_m", "triangles", "on_base")}
    np.savez(folder / "skin_mesh.npz", **skin)
    return data_set


@pytest.mark.fault("bags and data sets", "a press that no gel gives")
@pytest.mark.parametrize("what", list(REFUSED))
def test_what_no_press_gives_is_refused(refused, what, answered):
    entry = refused.entries[list(REFUSED).index(what)]
    with pytest.raises(BadBagError, match=REFUSED[what][1]) as error:
        PressReader(refused, SKIN, True).read(entry)
    assert "\n" not in str(error.value)
    answered(error.value, what=what)


def not_a_number(message: Any) -> None:
    message.wrench.force.z = np.nan


def out_of_order(message: Any) -> None:
    message.header.stamp.sec = 1


@pytest.mark.parametrize(
    ("topic", "change", "reason"),
    [
        ("/indenter/wrench", not_a_number, "message 3: .*not finite.*drop"),
        ("/indenter/pose", out_of_order, "message 3: stamp .* does not come after .*one clock"),
    ],
)
def test_a_message_that_no_writer_takes_is_refused(tmp_path, topic, change, reason):
    data_set = written(tmp_path, press())
    (entry,) = data_set.entries
    bad = replace(entry, bag=tmp_path / "press")
    with BagReader(entry.bag) as good, BagFile(bad.bag) as file:
        for number, item in enumerate(good.messages(topic, "/indenter/pose")):
            message = item.message()
            if number == 3 * len({topic, "/indenter/pose"}) + (topic != "/indenter/pose"):
                change(message)
            file.write(item.topic, item.log_time_ns, message)
    with pytest.raises(BadBagError, match=f"^press, {topic}, {reason}"):
        PressReader(data_set, SKIN, True).read(bad)


def test_what_can_be_read_is_read_and_the_rest_is_named(tmp_path):
    data_set = written(tmp_path, press())
    (entry,) = data_set.entries
    wrong_topic = Topics(wrench="/tactile/skin")
    with pytest.raises(BadBagError, match=r"holds sensor_msgs/msg/PointCloud2, expected geometry"):
        read_bag(entry, topics=wrong_topic, channels=("pose", "wrench")).press()
    lost = replace(entry, name="lost", indenter="spere")
    both = replace(data_set, entries=(entry, lost))
    found, (omitted,) = PressReader(both, SKIN, True).read_all(["press", "lost"])
    assert [one.press.name for one in found] == ["press"]
    assert found[0].press.frame_count == len(STAMP_NS)
    assert omitted.name == "lost"
    assert re.search(r"lost: no mesh .*spere.*holds sphere.*correct the name", omitted.reason)


def test_the_gap_finder_reads_by_the_same_gates(refused):
    with pytest.raises(ValueError, match="no trajectory can be used"):
        read_measurement(refused.directory, own_skin=SKIN)


def hidden(name: str, size: float) -> Callable[[Trajectory], Trajectory]:
    """Return what a hidden law does to what is measured of a press."""
    law = LAWS[name]

    def changed(good: Trajectory) -> Trajectory:
        assert good.pose is not None
        assert good.skin is not None
        stamp_s = 1e-9 * STAMP_NS
        random = np.random.default_rng(0)
        if law.motion is not None:
            motion = LawMotion(good.pose.poses(), stamp_s, good.wrench.force_n)
            poses: list[Pose] = law.motion(motion, size, np.random.default_rng(0), random)
            position = np.stack([pose.position_m for pose in poses])
            return replace(good, pose=replace(good.pose, position_m=position))
        assert law.answer is not None
        answer = LawAnswer(
            good.skin.position_m.astype(np.float64),
            good.wrench.force_n,
            SKIN.rest_position_m,
            stamp_s,
            30.0,
        )
        skin, force = law.answer(answer, size)
        return forces(lambda _: force)(skins(lambda _: skin)(good))

    return changed


FAULTS = {
    **{
        f"hidden {name}": hidden(name, 2.0 * law.high)
        for name, law in LAWS.items()
        if law.motion is not None or law.answer is not None
    },
    "a zero that drifts": forces(lambda f: f + np.linspace(0.0, 0.4, len(f))[:, None]),
    "a gauge that reads a third too low": forces(lambda f: 0.67 * f),
    "noise of 0.1 N": forces(lambda f: f + 0.1 * np.random.default_rng(1).standard_normal(f.shape)),
    "skin points off by 0.5 mm": skins(
        lambda x: x + 0.5e-3 * np.random.default_rng(1).standard_normal(x.shape)
    ),
    "one point in twenty anywhere": skins(
        lambda x: np.where(np.arange(x.shape[1])[:, None] % 20, x, 0.0)
    ),
    "a frame with a slash, as ROS 1 wrote it": framed("pose", "/densetact_base"),
    "no force": lambda good: replace(good, wrench=None),
    "no skin": lambda good: replace(good, skin=None),
}


def test_what_sensors_have_passes(tmp_path):
    changed = {what: change(press()) for what, change in FAULTS.items()}
    soft_to_hard = {f"{modulus:g} Pa": press(modulus) for modulus in (5.0e3, 3.0e4, 1.0e6, 8.0e6)}
    presses = [
        (replace(one, name=what.replace("/", " ")), BALL)
        for what, one in (changed | soft_to_hard).items()
    ]
    data_set = write_data_set(tmp_path / "data", presses, skin=SKIN)
    names = [entry.name for entry in data_set.entries]
    found, omitted = PressReader(data_set, SKIN, True).read_all(names)
    assert not omitted
    assert len(found) == len(FAULTS) + 4


def test_points_need_no_order_where_there_is_no_mesh(tmp_path):
    read(written(tmp_path, skins(lambda x: x[:, ::-1])(press())), has_vertices=False)


def test_a_base_frame_of_another_name_is_said_in_the_index(tmp_path):
    other = press()
    for channel in ("pose", "wrench", "skin"):
        other = framed(channel, "finger_base")(other)
    index = written(tmp_path, other).directory / "dataset.yaml"
    content = yaml.safe_load(index.read_text())
    index.write_text(yaml.safe_dump({"base_frame": "finger_base", **content}))
    read(read_data_set(index.parent))
    index.write_text(yaml.safe_dump({"base_frame": 7, **content}))
    with pytest.raises(ValueError, match="base_frame is 7, expected the name"):
        read_data_set(index.parent)


IDLE = np.full((6, 8, 3), 90, np.uint8)
FILM = np.stack([IDLE + number for number in range(len(STAMP_NS))]).astype(np.uint8)


@pytest.mark.fault("bags and data sets", "images, or forces next to them, by another clock")
@pytest.mark.parametrize("channel", ["image", "wrench"])
def test_images_by_another_clock_are_refused(tmp_path, channel, answered):
    good = replace(press(), image=ImageChannel(STAMP_NS, FILM))
    (entry,) = written(tmp_path / "good", good).entries
    assert read_press_images(entry, idle=IDLE).press.frame_count == len(STAMP_NS)
    (entry,) = written(tmp_path / "late", later(channel, 0.1)(good)).entries
    read_press_images(entry, idle=IDLE)
    (entry,) = written(tmp_path / "bad", later(channel, 0.9)(good)).entries
    with pytest.raises(BadBagError, match=r"begins and ends 0\.90 s after /indenter/pose") as error:
        read_press_images(entry, idle=IDLE)
    answered(error.value, what=f"{channel} stamped 0.9 s later than the poses")


def test_what_is_wrong_with_one_channel_leaves_the_others(tmp_path, monkeypatch):
    opened = []

    class CountedReader(BagReader):
        def __init__(self, path: Path) -> None:
            opened.append(path.name)
            super().__init__(path)

    monkeypatch.setattr(reading, "BagReader", CountedReader)
    still = np.repeat(IDLE[None], len(STAMP_NS), axis=0)
    good = replace(press(), image=ImageChannel(STAMP_NS, FILM))
    each = [
        replace(good, name="all"),
        replace(framed("skin", "elsewhere")(good), name="images_alone"),
        replace(good, name="press_alone", image=ImageChannel(STAMP_NS, still)),
    ]
    data_set = write_data_set(
        tmp_path / "data", [(one, BALL) for one in each], skin=SKIN, idle_images=[IDLE]
    )
    found = read_measurement(data_set, own_skin=SKIN, images=True)
    assert [one.name for one in found.recordings] == ["all", "press_alone"]
    assert [one.images.press.name for one in found.footage] == ["all", "images_alone"]
    assert len(found.warnings) == len(found.image_warnings) == 1
    assert "frame_id is 'elsewhere'" in found.warnings[0]
    assert "the same to the bit" in found.image_warnings[0]
    assert opened == ["all", "images_alone", "press_alone"]


@pytest.mark.fault("bags and data sets", "a camera that gives one image again and again")
def test_images_that_stand_still_are_refused(tmp_path, answered):
    images = ImageChannel(STAMP_NS, np.repeat(IDLE[None], len(STAMP_NS), axis=0))
    (entry,) = written(tmp_path, replace(press(), image=images)).entries
    with pytest.raises(BadBagError, match=r"all 9 images are the same to the bit") as refused:
        read_press_images(entry, idle=IDLE)
    answered(refused.value)


def test_the_skin_of_another_sensor_is_refused():
    pad = flat_pad_skin((0.03, 0.03), 0.01, 2e-3)
    with pytest.raises(ValueError, match=r"the skin of data lies .* mm off that of the sensor pad"):
        check_same_shape(SKIN, pad, data="data", sensor="pad")
    check_same_shape(SKIN, dome_skin(RADIUS_M * 1.1, 3e-3), data="data", sensor="dome")
