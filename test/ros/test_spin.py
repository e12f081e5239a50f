# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How every node starts and ends: `run_node`, on nodes that make it hard, and the real ones."""

import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from harness import START_PATIENCE_S, Executable, check_interrupts

PROGRAM = """
import sys, threading, time
from rclpy.utilities import try_shutdown
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node

class Hard(WorkingNode):
    def __init__(self):
        super().__init__("hard")
        self.make()

    def make(self):
        pass
{methods}
sys.exit(run_node(Hard))
"""

SLOW_TO_START = """
    def make(self):
        print("starting", flush=True)
        time.sleep(60.0)
"""

SLOW_TO_STOP = """
    def make(self):
        self.timer = self.create_timer(0.01, self.tell)

    def tell(self):
        self.timer.cancel()
        print("starting", flush=True)

    def destroy_node(self):
        time.sleep(0.5)
        print("finished", flush=True)
        super().destroy_node()
"""

SLOW_TO_BEGIN = """
    def begin(self):
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.stop.wait)
        self.thread.start()
        print("starting", flush=True)
        time.sleep(0.5)
        print("begun", flush=True)

    def destroy_node(self):
        self.stop.set()
        self.thread.join()
        print("finished", flush=True)
        super().destroy_node()
"""

ENDS_ITSELF = """
    def make(self):
        self.exit_status = 3
        self.create_timer(0.01, try_shutdown)
"""

BREAKS = """
    def make(self):
        self.create_timer(0.01, self.fail)

    def fail(self):
        raise RuntimeError("a bug")
"""


def executable(methods: str) -> Executable:
    return Executable("", code=PROGRAM.format(methods=methods))


def started(methods: str) -> Executable:
    node = executable(methods)
    node.wait_for_line("starting")
    assert node.log.startswith("starting\n")
    return node


@pytest.mark.parametrize(
    "methods",
    [SLOW_TO_START, SLOW_TO_BEGIN, SLOW_TO_STOP],
    ids=["starting", "beginning", "stopping"],
)
def test_doubled_interrupt_ends_cleanly(methods: str) -> None:
    node = started(methods)
    assert node.interrupt(2) == 0, node.log
    assert "Traceback" not in node.log
    assert ("begun" in node.log) == (methods is SLOW_TO_BEGIN)
    assert ("finished" in node.log) == (methods is not SLOW_TO_START)


def test_terminate_ends_cleanly() -> None:
    node = started(SLOW_TO_STOP)
    node.process.send_signal(signal.SIGTERM)
    assert node.exit_status() == 0, node.log
    assert "finished" in node.log


def test_node_ends_itself_with_its_status() -> None:
    assert executable(ENDS_ITSELF).exit_status() == 3


def test_bug_is_not_swallowed() -> None:
    node = executable(BREAKS)
    assert node.exit_status() == 1
    assert "RuntimeError: a bug" in node.log


def test_simulated_time_without_a_clock_is_told_and_two_sigints_end_it() -> None:
    told = {
        "tactile_sim": "/clock is silent",
        "xarm_sim": "/clock is silent",
        "indenter_player": "no /clock comes",
    }
    with ExitStack() as stack:
        # All at once: each is silent for seconds before it says so.
        nodes = {
            name: Executable(f"dotsim_ros.nodes.{name}.node", {"use_sim_time": True})
            for name in told
        }
        for node in nodes.values():
            stack.callback(node.end)
        for name, node in nodes.items():
            node.wait_for_line(told[name])
            # test_in_the_middle.py interrupts a node that is at work.
            assert node.interrupt(2) == 0, node.log
            assert "Traceback" not in node.log


@pytest.mark.fault("node parameters", "a home that cannot be written, for the logs of ROS")
def test_a_home_that_cannot_be_written_ends_no_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answered: Callable[..., None]
) -> None:
    (tmp_path / "home").write_text("a file")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    for name in ("ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    node = Executable("dotsim_ros.nodes.xarm_sim.node", {})
    try:
        node.wait_for_line("ready:")
        assert node.interrupt(1) == 0, node.log
    finally:
        node.end()
    (line,) = (each for each in node.log.splitlines() if "nothing can be kept in" in each)
    assert "set ROS_LOG_DIR to a folder that can be written" in line
    answered(line)
    (kept,) = (tmp_path / "temporary").glob("dotsim_ros-*")
    assert list(kept.glob("*.log"))


@pytest.mark.parametrize(
    ("node", "parameters"),
    # The player waits for a subscriber.
    [("indenter_player", {}), ("xarm_sim", {}), ("tactile_sim", {"grid_spacing_m": 0.0048})],
)
def test_a_node_ends_at_the_first_sigint_at_whatever_moment(
    node: str, parameters: dict[str, object]
) -> None:
    check_interrupts(node, count=2, parameters=parameters)


def test_a_node_that_is_being_imported_ends_quietly() -> None:
    code = "from dotsim_ros.nodes.executables import tactile_sim; tactile_sim()"
    # Python says on stderr what it has imported.
    command = [sys.executable, "-X", "importtime", "-c", code]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        assert any("numpy" in line for line in lines)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=START_PATIENCE_S)
    assert process.returncode == 0
    assert "tactile_sim.node\n" not in errors, "it was imported before the signal came"
    assert "Traceback" not in output + errors
