# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A stepper with light nodes that take part, and a user who watches them and calls services."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from harness import Executable, Watcher
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

import msg_adapters
from dotsim_ros.nodes.simulated_time.participants import read_participants
from dotsim_ros.nodes.simulated_time.stepper import Stepper, StepperSettings, SteppingError

MODULE = "dotsim_ros.nodes.time_stepper.node"
TICK_S = 0.02
BEAT_S = 0.05

WORKER = """
from geometry_msgs.msg import PoseStamped, TwistStamped
from std_msgs.msg import Empty
from std_srvs.srv import Trigger
import msg_adapters
from dotsim_ros.nodes.common.life_cycle import LifeCycle
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.common.spin import run_node


class Worker(WorkingNode):
    def __init__(self):
        super().__init__("worker")
        self.life_cycle = LifeCycle(self, self)
        self.life_cycle.start()

    def begin(self):
        self.life_cycle.begin()
        self.get_logger().info("ready: worker")

    def configure(self):
        self.counts = [0, 0, 0]
        self.ticks = self.create_publisher(PoseStamped, "ticks", 5)
        self.create_subscription(Empty, "replies", lambda message: self.count(1), 5)
        self.create_subscription(TwistStamped, "beats", lambda message: self.count(2), 5)
        self.create_service(Trigger, "~/reset", self.on_reset)

    def activate(self):
        pace = FramePace(rate_hz=50.0, start_s=self.now_s())
        self.end = self.start_paced("ticks", lambda: pace, self.tick, "ticking failed")

    def deactivate(self):
        self.end()

    def clean_up(self):
        self.ticks = None

    def count(self, what):
        self.counts[what] += 1

    def on_reset(self, request, response):
        self.counts = [0, 0, 0]
        response.success = True
        return response

    def tick(self):
        self.count(0)
        self.ticks.publish(
            msg_adapters.encode_pose_stamped(
                self.counts, (0.0, 0.0, 0.0, 1.0), stamp_ns=self.time_ns(), frame_id="base"
            )
        )


raise SystemExit(run_node(Worker))
"""
"""A managed node that publishes every 20 ms how many ticks it has sent, and how many replies and
beats it has heard."""

CONTROLLER = """
import time
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Empty


class Controller(Node):
    def __init__(self):
        super().__init__("controller")
        self.silent_after = self.declare_parameter("silent_after", 10**9).value
        self.count = 0
        self.replies = self.create_publisher(Empty, "replies", 5)
        self.beats = self.create_publisher(TwistStamped, "beats", 5)
        self.create_subscription(PoseStamped, "ticks", self.on_tick, 5)
        self.create_timer(0.05, self.beat)
        self.get_logger().info("ready: controller")

    def on_tick(self, message):
        self.count += 1
        # Longer than a step takes: what is not waited for would come late.
        time.sleep(0.002)
        if self.count <= self.silent_after:
            self.replies.publish(Empty())

    def beat(self):
        message = TwistStamped()
        message.header.stamp = self.get_clock().now().to_msg()
        self.beats.publish(message)


rclpy.init()
try:
    rclpy.spin(Controller())
except (KeyboardInterrupt, ExternalShutdownException):
    rclpy.try_shutdown()
"""
"""Knows nothing of steps: replies to each tick, without a stamp, and beats by a timer."""

WORKER_ENTRY = "  worker: {}\n"
REPLYING = "    reads: [ticks]\n    publishes:\n      replies: {for_each: ticks}\n"
CONTROLLER_ENTRY = f"  controller:\n{REPLYING}      beats: {{every_s: {BEAT_S}}}\n"

_numbers = itertools.count()


class Session(Watcher):
    """A stepper and the nodes that take part, in a namespace of their own.

    Attributes:
        clock_ns: every time that /clock has told, in order.
        ticks: of the worker: stamp (s), count, replies and beats heard.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._stack = stack
        self._folder = folder
        self.namespace = f"/steps_{next(_numbers)}"
        self.clock_ns: list[int] = []
        self.ticks: list[tuple[float, int, int, int]] = []
        super().__init__("user", self.namespace)
        stack.callback(self.close)
        deep = QoSProfile(history=HistoryPolicy.KEEP_ALL)
        self.node.create_subscription(Clock, "/clock", self._on_clock, deep)
        self.node.create_subscription(PoseStamped, "ticks", self._on_tick, deep)

    @property
    def time(self) -> msg_adapters.Status | None:
        """Return the newest state of the stepper, None before the first."""
        return self.diagnostics.get(f"{self.namespace[1:]}/time_stepper: time")

    def start(self, code: str, **parameters: Any) -> Executable:
        """Start a participant."""
        return self._run(Executable("", parameters, ("-r", f"__ns:={self.namespace}"), code=code))

    def step(self, participants: str = WORKER_ENTRY, **parameters: Any) -> Executable:
        """Start the stepper."""
        path = self._folder / f"participants_{next(_numbers)}.yaml"
        path.write_text(f"participants:\n{participants}")
        given = {"participants": path, "diagnostics_period_s": 0.1, **parameters}
        return self._run(Executable(MODULE, given, ("-r", f"__ns:={self.namespace}")))

    def begin(self, participants: str = WORKER_ENTRY, **parameters: Any) -> Executable:
        """Start the stepper, and let time run once all that it brings about is heard here."""
        stepper = self.step(participants, paused="true", **parameters)
        stepper.wait_for_line("simulated time begins")
        self.wait(lambda: self.trigger("step").success and self.ticks and self.clock_ns, "a tick")
        self.clock_ns.clear()
        self.ticks.clear()
        self.pause(False)
        self.wait(lambda: self.clock_ns, "the time that runs")
        return stepper

    @contextmanager
    def stepping(self, participants: str = WORKER_ENTRY) -> Iterator[Stepper]:
        """Step participants from here: a stepper without a node of its own to start."""
        path = self._folder / f"participants_{next(_numbers)}.yaml"
        path.write_text(f"participants:\n{participants}")
        with closing(Watcher("time_stepper", self.namespace)) as watcher:
            yield Stepper(watcher.node, read_participants(path), StepperSettings())

    def reason(self, stepper: Stepper, *, patience_s: float = 120.0) -> str:
        """Step until that fails; return why, as in no namespace."""
        stepper.settings = replace(stepper.settings, patience_s=patience_s)
        with pytest.raises(SteppingError) as caught:
            stepper.advance(60.0)
        return str(caught.value).replace(f"{self.namespace[1:]}/", "")

    def hindrance(self, stepper: Stepper, text: str) -> str:
        """Wait until time cannot begin for a reason; return it, as in no namespace."""

        def join() -> None:
            with suppress(SteppingError):
                stepper.join()

        def found() -> str:
            plain = stepper.waiting_for.replace(f"{self.namespace[1:]}/", "")
            return plain if text in plain else ""

        thread = threading.Thread(target=join)
        thread.start()
        try:
            return self.wait(found, text)
        finally:
            stepper.cancel()
            thread.join()

    def fatal(self, executable: Executable) -> str:
        """Return the one line with which a node has ended, as in no namespace."""
        (line,) = [line for line in executable.log.splitlines() if "[FATAL]" in line]
        assert "Traceback" not in executable.log
        return line.partition("]: ")[2].replace(f"{self.namespace[1:]}/", "")

    def _run(self, executable: Executable) -> Executable:
        self._stack.callback(executable.end)
        return executable

    def wait_for_time(self, time_s: float) -> None:
        """Wait until the simulated time has come so far."""
        self.wait(lambda: self.clock_ns and self.clock_ns[-1] >= 1e9 * time_s, f"{time_s} s")

    def wait_for_state(
        self, state: str, is_wanted: Callable[[msg_adapters.Status], bool] = lambda _: True
    ) -> msg_adapters.Status:
        """Wait until the stepper reports a state that is wanted."""
        return self.wait(
            lambda: (
                (found := self.time)
                and found.values["state"] == state
                and is_wanted(found)
                and found
            ),
            f"the state {state}",
        )

    def trigger(self, name: str) -> Any:
        """Call a service without arguments."""
        return self.call(Trigger, f"time_stepper/{name}")

    def pause(self, wanted: bool = True) -> Any:
        """Pause, or let time run."""
        return self.call(SetBool, "time_stepper/pause", data=wanted)

    def _on_clock(self, message: Clock) -> None:
        now_ns = message.clock.sec * 10**9 + message.clock.nanosec
        self.clock_ns.append(now_ns)

    def _on_tick(self, message: PoseStamped) -> None:
        place = message.pose.position
        stamp_s = 1e-9 * msg_adapters.message_stamp_ns(message)
        self.ticks.append((stamp_s, int(place.x), int(place.y), int(place.z)))


@contextmanager
def session(folder: Path) -> Iterator[Session]:
    """Begin with nothing; end all that was started in the block."""
    with ExitStack() as stack:
        yield Session(folder, stack)
