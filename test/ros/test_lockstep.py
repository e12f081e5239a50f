# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The lockstep clock: one frame for each pose, repeatable to the bit, whatever else is sent."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from harness import APEX_M, Client, LockstepPress, TactileFrame, assert_same, sensor
from std_srvs.srv import Trigger

# What is repeated to the bit depends on no grid; a coarse one is made and solved sooner.
PARAMETERS = {"clock": "lockstep", "diagnostics_period_s": 0.1, "grid_spacing_m": 0.0048}
DEEP = (0.0, 0.0, APEX_M - 0.001)


@pytest.fixture(scope="module")
def reference() -> list[TactileFrame]:
    """Return the frames of the press from a fresh node of their own."""
    with sensor(**PARAMETERS) as (_, client):
        return LockstepPress(client).run()


@pytest.fixture(scope="module")
def press(reference: list[TactileFrame]) -> Iterator[LockstepPress]:
    """The press of another node, which starts once that of the reference has ended: both have the
    same names."""
    with sensor(**PARAMETERS) as (_, client):
        yield LockstepPress(client)


def count_of(client: Client, fault: str) -> int:
    return int(client.state_from_now("input").values[fault])


def test_two_nodes_give_the_same_frames_to_the_bit(
    press: LockstepPress, reference: list[TactileFrame]
) -> None:
    assert_same(press.run(), reference)
    forces_n = [frame.force_n()[2] for frame in reference]
    assert forces_n[0] == 0.0
    assert 0.0 < forces_n[1] < forces_n[2] < forces_n[3]
    assert not reference[3].is_same(reference[0])


def test_nothing_is_lost_and_every_stamp_is_carried_over(press: LockstepPress) -> None:
    press.frame_at((0.0, 0.0, APEX_M + 0.05))
    stamps = [
        press.client.send((0.0, 0.0, APEX_M - 1e-5 * k), stamp_ns=press.next_stamp())
        for k in range(20)
    ]
    for stamp_ns in stamps:
        assert stamp_ns in press.client.frames or press.client.whole_frame(stamp_ns)


BAD_POSES = {
    "nan": ("invalid_numbers", {"position_m": (math.nan, 0.0, APEX_M)}),
    "infinite": ("invalid_numbers", {"position_m": (0.0, math.inf, APEX_M)}),
    "zero quaternion": (
        "invalid_numbers",
        {"position_m": DEEP, "quaternion_xyzw": (0.0, 0.0, 0.0, 0.0)},
    ),
    "long quaternion": (
        "invalid_numbers",
        {"position_m": DEEP, "quaternion_xyzw": (0.0, 0.0, 0.0, 1.1)},
    ),
    "another frame": ("wrong_frame", {"position_m": DEEP, "frame_id": "map"}),
    "no frame": ("wrong_frame", {"position_m": DEEP, "frame_id": ""}),
    "time backwards": ("out_of_order", {"position_m": DEEP, "stamp_ns": -20_000_000}),
    "same time": ("out_of_order", {"position_m": DEEP, "stamp_ns": 0}),
}


def test_bad_poses_in_the_middle_of_a_press_change_nothing(
    press: LockstepPress, reference: list[TactileFrame]
) -> None:
    before = press.client.state_from_now("input").values

    def send_bad_poses(index: int) -> None:
        if index == 2:
            for _, fields in BAD_POSES.values():
                offset_ns = fields.get("stamp_ns", 1_000_000)
                press.client.send(**{**fields, "stamp_ns": press.stamp_ns + offset_ns})

    assert_same(press.run(between=send_bad_poses), reference)
    faults = [fault for fault, _ in BAD_POSES.values()]
    state = press.client.wait_for_state(
        "input",
        lambda state: all(
            int(state.values[each]) == int(before[each]) + faults.count(each) for each in faults
        ),
    )
    assert "expected" in state.values["last_fault"] or "not finite" in state.values["last_fault"]


DISTURBANCES = {
    "a jump of 50 mm": (0.05, 0.0, APEX_M - 0.001),
    "20 mm of penetration": (0.0, 0.0, APEX_M - 0.02),
    "an indenter inside of the dome": (0.004, 0.0, 0.006),
}


@pytest.mark.parametrize("name", DISTURBANCES)
def test_the_press_after_a_wild_pose_is_that_of_a_fresh_node(
    press: LockstepPress, reference: list[TactileFrame], name: str
) -> None:
    press.frame_at((0.0, 0.0, APEX_M + 0.05))
    press.frame_at(DEEP)
    press.client.send(DISTURBANCES[name], stamp_ns=press.next_stamp())
    assert_same(press.run(), reference)


def test_wild_poses_first_of_all_are_survived(
    press: LockstepPress, reference: list[TactileFrame]
) -> None:
    assert press.client.call(Trigger, "/tactile_sim/reset").success
    # A refused one is answered by the gel at rest.
    frame = press.frame_at((0.0, 0.0, APEX_M - 0.02))
    assert frame.force_n().tolist() == [0.0, 0.0, 0.0]
    assert frame.indenter_m() is None
    for position_m in DISTURBANCES.values():
        press.client.send(position_m, stamp_ns=press.next_stamp())
    assert_same(press.run(), reference)


def test_20_mm_of_penetration_is_refused_in_words_and_the_last_frame_holds(
    press: LockstepPress,
) -> None:
    before = count_of(press.client, "refused_by_gel")
    press.frame_at((0.0, 0.0, APEX_M + 0.05))
    pressed = press.frame_at(DEEP)
    # As a frame of its own, with the stamp that a player or a simulator waits for.
    held = press.frame_at((0.0, 0.0, APEX_M - 0.02))
    assert held.is_same(pressed)
    assert held.indenter_m() == list(DEEP)
    press.client.wait_for_state(
        "input", lambda state: int(state.values["refused_by_gel"]) == before + 1
    )


def test_time_that_starts_again_is_a_new_start(
    press: LockstepPress, reference: list[TactileFrame]
) -> None:
    before = count_of(press.client, "time_restarts")
    press.frame_at((0.0, 0.0, APEX_M + 0.05))
    press.frame_at(DEEP)
    press.stamp_ns -= 5_000_000_000
    press.client.frames.clear()
    assert_same(press.run(), reference)
    press.client.wait_for_state(
        "input", lambda state: int(state.values["time_restarts"]) == before + 1
    )


def test_reset_in_the_middle_of_a_press(
    press: LockstepPress, reference: list[TactileFrame]
) -> None:
    def reset(index: int) -> None:
        if index == 3:
            assert press.client.call(Trigger, "/tactile_sim/reset").success

    press.run(between=reset)
    assert_same(press.run(), reference)


def open_box(path: Path) -> Path:
    """Write a cube of 4 mm that lacks a face."""
    import trimesh

    box = trimesh.creation.box((0.004, 0.004, 0.004))
    trimesh.Trimesh(box.vertices, box.faces[:-2]).export(path)
    return path


def test_a_broken_mesh_is_refused_and_the_indenter_stays(
    press: LockstepPress, reference: list[TactileFrame], tmp_path: Path
) -> None:
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"solid this is no mesh")
    for path in (broken, open_box(tmp_path / "open.stl"), tmp_path / "missing.stl"):
        result = press.client.set_parameters(indenter=str(path))
        assert not result.successful
        assert path.name in result.reason
    assert_same(press.run(), reference)
