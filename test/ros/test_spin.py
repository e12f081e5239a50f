# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`run_node`, the way every node starts and stops, on nodes that make it hard."""

import signal
import subprocess
import sys
import time

import pytest
from harness import Executable

SLOW_TO_START = """
import sys, time
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node

class Slow(WorkingNode):
    def __init__(self):
        super().__init__("slow")
        print("starting", flush=True)
        time.sleep(60.0)

sys.exit(run_node(Slow))
"""

SLOW_TO_STOP = """
import sys, time
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node

class Slow(WorkingNode):
    def __init__(self):
        super().__init__("slow")
        self.timer = self.create_timer(0.01, self.tell)

    def tell(self):
        self.timer.cancel()
        print("starting", flush=True)

    def destroy_node(self):
        time.sleep(0.5)
        print("finished", flush=True)
        super().destroy_node()

sys.exit(run_node(Slow))
"""

SLOW_TO_BEGIN = """
import sys, threading, time
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node

class Slow(WorkingNode):
    def __init__(self):
        super().__init__("slow")
        self.stop = threading.Event()

    def begin(self):
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

sys.exit(run_node(Slow))
"""

ENDS_ITSELF = """
import sys
from dotsim_ros.nodes.common.node import WorkingNode
from rclpy.utilities import try_shutdown
from dotsim_ros.nodes.common.spin import run_node

class Short(WorkingNode):
    def __init__(self):
        super().__init__("short")
        self.exit_status = 3
        self.create_timer(0.01, try_shutdown)

sys.exit(run_node(Short))
"""

BREAKS = """
import sys
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node

class Wrong(WorkingNode):
    def __init__(self):
        super().__init__("wrong")
        self.create_timer(0.01, self.fail)

    def fail(self):
        raise RuntimeError("a bug")

sys.exit(run_node(Wrong))
"""


def started(code):
    executable = Executable("", code=code)
    executable.wait_for_line("starting")
    assert executable.log.startswith("starting\n")
    return executable


@pytest.mark.parametrize(
    "code",
    [SLOW_TO_START, SLOW_TO_BEGIN, SLOW_TO_STOP],
    ids=["starting", "beginning", "stopping"],
)
def test_doubled_interrupt_ends_cleanly(code):
    executable = started(code)
    for _ in range(2):
        executable.process.send_signal(signal.SIGINT)
        time.sleep(0.02)
    status, log = executable.exit_status(30.0), executable.log
    assert status == 0, log
    assert "Traceback" not in log
    assert ("begun" in log) == (code is SLOW_TO_BEGIN)
    assert ("finished" in log) == (code is not SLOW_TO_START)


def test_terminate_ends_cleanly():
    executable = started(SLOW_TO_STOP)
    executable.process.send_signal(signal.SIGTERM)
    status, log = executable.exit_status(30.0), executable.log
    assert status == 0, log
    assert "finished" in log


def test_node_ends_itself_with_its_status():
    done = subprocess.run([sys.executable, "-c", ENDS_ITSELF], timeout=60, check=False)
    assert done.returncode == 3


def test_bug_is_not_swallowed():
    done = subprocess.run(
        [sys.executable, "-c", BREAKS], timeout=60, check=False, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "RuntimeError: a bug" in done.stderr
