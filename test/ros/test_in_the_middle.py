# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What comes in the middle of a motion: resets, changes, signals, and bugs of ours."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from harness import APEX_M, PATIENCE_S, Client, Executable, TactileFrame, running, sensor
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import CompressedImage, PointCloud2
from std_srvs.srv import SetBool, Trigger

import msg_adapters
from msg_adapters import Level

START_M = (0.0, 0.0, APEX_M - 0.001)
# A way along the skin that takes the limited motion of several frames.
END_M = (0.0075, 0.0, 0.01284)


@dataclass(frozen=True)
class Written:
    """A message by when its publisher wrote it, which is not when it arrives."""

    written_ns: int
    message: Any


@dataclass(frozen=True)
class Scene:
    """A node whose images take long, and what a client has read of two of its topics."""

    node: Executable
    client: Client
    points: list[Written]
    compressed: list[Written]

    def points_after(self, time_ns: int) -> list[Written]:
        return [each for each in list(self.points) if each.written_ns > time_ns]

    def compressed_after(self, time_ns: int) -> list[Written]:
        return [each for each in list(self.compressed) if each.written_ns > time_ns]


@pytest.fixture(scope="module")
def scene() -> Iterator[Scene]:
    parameters = {"compression": "png", "image_size_px": [1200, 900], "grid_spacing_m": 0.0048}
    with sensor(diagnostics_period_s=0.1, **parameters) as (node, client):
        found = Scene(node, client, [], [])
        for kind, topic, entries in (
            (CompressedImage, "image_raw/compressed", found.compressed),
            (PointCloud2, "points", found.points),
        ):

            def note(message: Any, info: dict[str, int], entries: list[Written] = entries) -> None:
                entries.append(Written(info["source_timestamp"], message))

            client.node.create_subscription(kind, topic, lambda m, i, n=note: n(m, i), 50)
        client.wait(lambda: found.compressed and found.points, "the first frames")
        yield found


def is_at_rest(frame: TactileFrame) -> bool:
    return bool(np.all(frame.force_n() == 0.0))


def start_sliding(client: Client) -> None:
    """Press, and return in the middle of a slide that is on its way without further poses."""
    client.send((0.0, 0.0, APEX_M + 0.05))
    client.next_frame(is_at_rest)
    client.send(START_M)
    begun = client.next_frame(lambda frame: frame.indenter_m() == list(START_M))
    client.send(END_M)

    def is_under_way(frame: TactileFrame) -> bool:
        place = frame.indenter_m()
        return place is not None and START_M[0] < place[0] < END_M[0]

    client.next_frame(is_under_way, after=begun)


def answer_of(client: Client, kind: type, name: str, **fields: Any) -> tuple[Any, int]:
    """Call a service; return its answer and when that came, by the clock of the writers."""
    caller = client.node.create_client(kind, f"/tactile_sim/{name}")
    assert caller.wait_for_service(PATIENCE_S)
    came_ns: list[int] = []
    future = caller.call_async(kind.Request(**fields))
    future.add_done_callback(lambda _: came_ns.append(time.time_ns()))
    client.wait(lambda: came_ns, "the answer")
    return future.result(), came_ns[0]


def assert_nothing_stale_after(scene: Scene, time_ns: int) -> None:
    """Wait for frames that were written after a time, and assert that they show a gel at rest."""
    scene.client.wait(
        lambda: scene.points_after(time_ns)[3:] and scene.compressed_after(time_ns)[3:],
        "frames after the answer",
    )
    for entry in scene.points_after(time_ns):
        assert not msg_adapters.decode_cloud(entry.message).displacement.any()


def test_stamps_go_up_and_no_frame_is_written_twice(scene: Scene) -> None:
    start_sliding(scene.client)
    scene.client.next_frame(lambda frame: frame.indenter_m() == list(END_M))
    stamps_ns = [msg_adapters.message_stamp_ns(each.message) for each in list(scene.points)]
    assert all(np.diff(stamps_ns) > 0)


def test_no_frame_of_before_is_written_after_the_answer_to_a_reset(scene: Scene) -> None:
    start_sliding(scene.client)
    answer, answered_ns = answer_of(scene.client, Trigger, "reset")
    assert answer.success
    assert_nothing_stale_after(scene, answered_ns)


def test_no_frame_of_before_is_written_after_the_indenter_was_changed(scene: Scene) -> None:
    changed = Parameter("indenter", value="{kind: sphere, radius_m: 0.003}").to_parameter_msg()
    start_sliding(scene.client)
    answer, answered_ns = answer_of(
        scene.client, SetParametersAtomically, "set_parameters_atomically", parameters=[changed]
    )
    assert answer.result.successful
    assert_nothing_stale_after(scene, answered_ns)
    assert scene.client.set_parameters(indenter="sphere_4mm").successful


def test_no_frame_at_all_is_written_after_the_answer_to_a_disable(scene: Scene) -> None:
    client = scene.client
    start_sliding(client)
    answer, answered_ns = answer_of(client, SetBool, "set_enabled", data=False)
    assert answer.success
    try:
        for _ in range(3):
            client.diagnostics.clear()
            state = client.wait_for_state("frames", lambda state: "disabled" in state.message)
        assert state.level is Level.WARN
        assert scene.points_after(answered_ns) == scene.compressed_after(answered_ns) == []
        # What is sent meanwhile moves nothing.
        client.send((0.0, 0.0, APEX_M - 0.001))
    finally:
        answer, answered_ns = answer_of(client, SetBool, "set_enabled", data=True)
    assert_nothing_stale_after(scene, answered_ns)


def test_an_image_that_takes_longer_than_a_frame_drops_frames_and_counts_them(
    scene: Scene,
) -> None:
    client = scene.client
    client.send((0.0, 0.0, APEX_M + 0.05))
    client.next_frame(is_at_rest)
    before = client.state("frames").values
    after = client.wait_for_state(
        "frames", lambda state: int(state.values["dropped"]) > int(before["dropped"]) + 5
    ).values
    assert int(after["frames"]) > int(before["frames"])


def test_two_signals_in_the_middle_of_a_slide_end_it_with_status_0(scene: Scene) -> None:
    # The last test of the scene.
    start_sliding(scene.client)
    assert scene.node.interrupt(2) == 0, scene.node.log
    assert "Traceback" not in scene.node.log


BREAKS = """
import sys
from threading import current_thread
from dotsim_ros.nodes.tactile_sim import configured_sensor
from dotsim_ros.nodes.tactile_sim.node import TactileSim
from dotsim_ros.nodes.common.spin import run_node

class BreakingSensor(configured_sensor.TactileSensor):
    def {method}(self, *arguments):
        # The session of the gel answers a ValueError by itself: a bug is something else.
        if current_thread().name == "frames":
            raise RuntimeError("a bug in {method}")
        return super().{method}(*arguments)

configured_sensor.TactileSensor = BreakingSensor
sys.exit(run_node(TactileSim))
"""


@pytest.mark.parametrize("method", ["press", "see"])
def test_a_bug_in_the_frames_ends_the_node_with_status_1(method: str) -> None:
    coarse = {"grid_spacing_m": 0.0048}
    with running(code=BREAKS.format(method=method), parameters=coarse) as node:
        # The gel is pressed for a pose only, the image made for its reader only.
        with closing(Client()) as client:
            while node.process.poll() is None:
                client.send(START_M)
                time.sleep(0.05)
        assert node.exit_status() == 1, node.log
        assert "the loop of frames failed" in node.log
        assert f"RuntimeError: a bug in {method}" in node.log
