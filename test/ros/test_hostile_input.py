# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""No parameter and no message ends a node, blocks it, or makes it grow: all the real ones at once.

`test_xarm_adapter.py` does the same to the adapter, whose messages have to be built first.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import hostile
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from harness import Executable
from rcl_interfaces.msg import ParameterType, ParameterValue
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

import msg_adapters

POLICY = "densetact2_sphere"
PARAMETERS: dict[str, dict[str, Any]] = {
    "tactile_sim": {"grid_spacing_m": 0.0048},
    "xarm_sim": {},
    "tactile_policy": {"policy": POLICY, "force_limit_n": 2.0},
    "indenter_player": {
        "loop": "true",
        "wait_for_answer": "true",
        "answer_timeout_s": 0.05,
        "wait_for_subscriber_s": 0.0,
    },
    "tactile_record": {"topics": "['wrench']"},
}
READY = {"tactile_record": "recording"}


@dataclass
class Attacked:
    """A node and who attacks it."""

    name: str
    executable: Executable
    attacker: hostile.Attacker

    def check(self) -> None:
        """Assert that the node is there, and that nothing went wrong in it unforeseen."""
        assert self.attacker.is_well()
        assert self.executable.process.poll() is None, self.executable.log[-3000:]
        assert "Traceback" not in self.executable.log, self.executable.log[-3000:]
        found = re.findall("^.*unexpected [A-Z].*$", self.executable.log, re.MULTILINE)
        assert not found, found[0][:300]


Nodes = dict[str, Attacked]


@contextmanager
def attacked(given: dict[str, dict[str, Any]], suffix: str) -> Iterator[Nodes]:
    """Run nodes with these parameters, each in a namespace of its own."""
    with ExitStack() as stack:
        started = {
            name: Executable(
                f"dotsim_ros.nodes.{name}.node", parameters, ("-r", f"__ns:=/{name}_{suffix}")
            )
            for name, parameters in given.items()
        }
        for executable in started.values():
            stack.callback(executable.end)
        found = {}
        for name, executable in started.items():
            executable.wait_for_line(READY.get(name, "ready:"))
            attacker = hostile.Attacker(f"/{name}_{suffix}", name, executable.process.pid)
            stack.callback(attacker.close)
            found[name] = Attacked(name, executable, attacker)
        yield found


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    bag = tmp_path_factory.mktemp("hostile") / "bag"
    recorder = {**PARAMETERS["tactile_record"], "output": bag}
    with attacked({**PARAMETERS, "tactile_record": recorder}, "of") as found:
        yield found


@pytest.fixture(scope="module")
def simulated_nodes() -> Iterator[Nodes]:
    given = {
        name: {**parameters, "use_sim_time": "true"}
        for name, parameters in PARAMETERS.items()
        if name != "tactile_record"
    }
    with attacked(given, "simulated") as found:
        yield found


@pytest.mark.fault("node parameters", "every parameter of a node is set to what makes no sense")
@pytest.mark.parametrize("name", PARAMETERS)
def test_no_parameter_ends_a_node(nodes: Nodes, name: str, answered: Any) -> None:
    reasons = hostile.try_every_parameter(nodes[name].attacker)
    nodes[name].check()
    if name == "tactile_sim":
        answers = dict(zip(hostile.TEXTS, reasons["indenter"], strict=False))
        for text, what in (
            ("{kind: [1]}", "`indenter` is `{kind: [1]}`"),
            ("{" + "[" * 3000, "`indenter` is 3,000 nested brackets"),
            (hostile.BOMB, "`indenter` is YAML of nested anchors"),
            ("/dev/zero.yaml", "`indenter` is `/dev/zero.yaml`"),
        ):
            answered(answers[text], what=what)


def pose(frame_id: str) -> PoseStamped:
    """Return a pose of now that is 10 m away."""
    return msg_adapters.encode_pose_stamped(
        (10.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), stamp_ns=time.time_ns(), frame_id=frame_id
    )


def wrench(frame_id: str) -> WrenchStamped:
    """Return a wrench of 100 N, of long ago."""
    return msg_adapters.encode_wrench_stamped(
        (0.0, 0.0, 100.0), (0.0, 0.0, 0.0), stamp_ns=10**9, frame_id=frame_id
    )


def twist(frame_id: str) -> TwistStamped:
    return TwistStamped(header=hostile.header(frame_id))


def test_no_message_ends_tactile_sim(nodes: Nodes) -> None:
    attacker = nodes["tactile_sim"].attacker
    before = attacker.memory_bytes()
    attacker.send(PoseStamped, "indenter/pose", hostile.spoilt(pose("densetact_base")))
    attacker.send(TwistStamped, "indenter/twist", hostile.spoilt(twist("densetact_base")))
    assert attacker.memory_bytes() - before < hostile.GROWTH_BYTES
    nodes["tactile_sim"].check()


def test_no_message_ends_xarm_sim(nodes: Nodes) -> None:
    nodes["xarm_sim"].attacker.send(TwistStamped, "cmd_vel", hostile.spoilt(twist("link_base")))
    nodes["xarm_sim"].check()


def test_no_message_ends_tactile_policy(nodes: Nodes) -> None:
    attacker = nodes["tactile_policy"].attacker
    attacker.send(PoseStamped, "ee_pose", hostile.spoilt(pose("link_base")))
    attacker.send(WrenchStamped, "wrench", hostile.spoilt(wrench("tool")))
    attacker.send(Image, "image_raw", hostile.images())
    nodes["tactile_policy"].check()


@pytest.mark.fault("messages", "`indenter_player` gets a wrench with a negative stamp")
def test_no_message_ends_indenter_player(nodes: Nodes, answered: Any) -> None:
    player = nodes["indenter_player"]
    player.attacker.send(WrenchStamped, "wrench", hostile.spoilt(wrench("densetact_base")))
    player.check()
    player.executable.wait_for_line("is no valid time")
    answered(hostile.lines_of(player.executable, "is no valid time")[0])


@pytest.mark.fault("messages", "`/clock` is negative")
@pytest.mark.parametrize("name", ["xarm_sim", "tactile_sim", "tactile_policy", "indenter_player"])
def test_no_clock_ends_a_node(simulated_nodes: Nodes, name: str, answered: Any) -> None:
    steady = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=False)
    clocks = [Clock(clock=each.stamp) for each in hostile.headers("")]
    node = simulated_nodes[name]
    node.attacker.send(Clock, "/clock", clocks, readers=len(simulated_nodes))
    (result,) = node.attacker.set("use_sim_time", [steady])
    assert not result.successful
    assert "fixed once the node runs" in result.reason
    node.check()
    if name == "xarm_sim":
        # ROS hears clocks in best effort and keeps only the newest: a busy node misses some.
        end_s = time.monotonic() + hostile.ANSWER_S
        while not (lines := hostile.lines_of(node.executable, "/clock is left out")):
            assert time.monotonic() < end_s, node.executable.log
            node.attacker.send(Clock, "/clock", clocks[4:5], readers=len(simulated_nodes))
        answered(lines[0])


def test_they_all_stop_as_ever(nodes: Nodes, simulated_nodes: Nodes) -> None:
    for name, node in [*nodes.items(), *simulated_nodes.items()]:
        assert node.executable.interrupt() == 0, f"{name}: {node.executable.log[-3000:]}"
