# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What comes in the middle of a motion: resets, changes, signals, and bugs of ours."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from harness import APEX_M, PATIENCE_S, Client, TactileFrame, running, sensor
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import CompressedImage, PointCloud2
from std_srvs.srv import SetBool, Trigger

import msg_adapters

START_M = (0.0, 0.0, APEX_M - 0.001)
# A way along the skin that takes the limited motion of several frames.
END_M = (0.0075, 0.0, 0.01284)


@dataclass(frozen=True)
class Written:
    """A message by when its publisher wrote it."""

    written_ns: int
    stamp_ns: int
    message: Any


class WriteLog:
    """Notes when the messages of a topic were written, which is not when they arrive."""

    def __init__(self, client: Client, kind: type, topic: str) -> None:
        self.entries: list[Written] = []
        client.node.create_subscription(kind, topic, self._note, 50)

    def _note(self, message: Any, info: dict[str, int]) -> None:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        self.entries.append(Written(info["source_timestamp"], stamp_ns, message))

    def after(self, time_ns: int) -> list[Written]:
        """Return what was written later than a time."""
        return [entry for entry in list(self.entries) if entry.written_ns > time_ns]


@dataclass(frozen=True)
class Scene:
    """A node whose images take long, and a client that sees when it writes."""

    client: Client
    points: WriteLog
    compressed: WriteLog


@pytest.fixture(scope="module")
def scene() -> Iterator[Scene]:
    with sensor(diagnostics_period_s=0.1, compression="png", image_size_px=[1600, 1200]) as (
        _,
        client,
    ):
        compressed = WriteLog(client, CompressedImage, "image_raw/compressed")
        points = WriteLog(client, PointCloud2, "points")
        client.wait(lambda: compressed.entries and points.entries, "the first frames")
        yield Scene(client, points, compressed)


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


def answer_of(client: Client, caller: Any, request: Any) -> tuple[Any, int]:
    """Call a service; return its answer and when that came, by the clock of the writers."""
    came_ns: list[int] = []
    future = caller.call_async(request)
    future.add_done_callback(lambda _: came_ns.append(time.time_ns()))
    client.wait(lambda: came_ns, "the answer")
    return future.result(), came_ns[0]


def is_stale(entry: Written) -> bool:
    cloud = msg_adapters.decode_cloud(entry.message)
    return bool(np.any(cloud.displacement != 0.0))


def wait_for_frames_after(scene: Scene, time_ns: int) -> None:
    scene.client.wait(
        lambda: scene.points.after(time_ns)[5:] and scene.compressed.after(time_ns)[5:],
        "frames after the answer",
    )


def assert_nothing_stale_after(scene: Scene, time_ns: int) -> None:
    wait_for_frames_after(scene, time_ns)
    assert not any(is_stale(entry) for entry in scene.points.after(time_ns))


def test_stamps_go_up_and_no_frame_is_written_twice(scene: Scene) -> None:
    start_sliding(scene.client)
    scene.client.next_frame(lambda frame: frame.indenter_m() == list(END_M))
    stamps = [entry.stamp_ns for entry in list(scene.points.entries)]
    assert all(np.diff(stamps) > 0)


@pytest.mark.parametrize("attempt", range(2))
def test_no_frame_of_before_is_written_after_the_answer_to_a_reset(
    scene: Scene, attempt: int
) -> None:
    caller = scene.client.node.create_client(Trigger, "/tactile_sim/reset")
    assert caller.wait_for_service(PATIENCE_S)
    start_sliding(scene.client)
    answer, answered_ns = answer_of(scene.client, caller, Trigger.Request())
    assert answer.success
    assert_nothing_stale_after(scene, answered_ns)


def test_no_frame_of_before_is_written_after_the_indenter_was_changed(scene: Scene) -> None:
    caller = scene.client.node.create_client(
        SetParametersAtomically, "/tactile_sim/set_parameters_atomically"
    )
    assert caller.wait_for_service(PATIENCE_S)
    start_sliding(scene.client)
    changed = Parameter("indenter", value="{kind: sphere, radius_m: 0.003}")
    request = SetParametersAtomically.Request(parameters=[changed.to_parameter_msg()])
    answer, answered_ns = answer_of(scene.client, caller, request)
    assert answer.result.successful
    assert_nothing_stale_after(scene, answered_ns)
    assert scene.client.set_parameters(indenter="sphere_4mm").successful


def test_no_frame_at_all_is_written_after_the_answer_to_a_disable(scene: Scene) -> None:
    client = scene.client
    caller = client.node.create_client(SetBool, "/tactile_sim/set_enabled")
    assert caller.wait_for_service(PATIENCE_S)
    start_sliding(client)
    answer, answered_ns = answer_of(client, caller, SetBool.Request(data=False))
    assert answer.success
    try:
        for _ in range(3):
            client.diagnostics.clear()
            client.wait_for_state("frames", lambda state: "disabled" in state.message)
        assert scene.points.after(answered_ns) == []
        assert scene.compressed.after(answered_ns) == []
    finally:
        answer, answered_ns = answer_of(client, caller, SetBool.Request(data=True))
    assert_nothing_stale_after(scene, answered_ns)


def test_an_image_that_takes_longer_than_a_frame_drops_frames_and_counts_them(
    scene: Scene,
) -> None:
    client = scene.client
    client.send((0.0, 0.0, APEX_M + 0.05))
    client.next_frame(is_at_rest)
    before = client.state("frames").values
    after = client.wait_for_state(
        "frames", lambda state: int(state.values["dropped"]) > int(before["dropped"]) + 10
    ).values
    assert int(after["frames"]) > int(before["frames"])


def test_two_signals_in_the_middle_of_a_slide_end_it_with_status_0() -> None:
    with sensor(grid_spacing_m=0.0048) as (node, client):
        start_sliding(client)
        assert node.interrupt(2) == 0, node.log
        assert "Traceback" not in node.log


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
        client = Client()
        try:
            # The gel is pressed for a pose only, the image made for its reader only.
            while node.process.poll() is None:
                client.send(START_M)
                time.sleep(0.05)
            assert node.exit_status() == 1, node.log
        finally:
            client.close()
        assert "the loop of frames failed" in node.log
        assert f"RuntimeError: a bug in {method}" in node.log
