# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A /clock that runs at any pace, whoever listens, and stands still on request."""

from __future__ import annotations

import threading
import time
from contextlib import AbstractContextManager, closing

from harness import Watcher
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

import msg_adapters

PERIOD_S = 0.005


class FreeClock(Watcher):
    """Publishes simulated time.

    Args:
        speed: simulated seconds for each real one.

    Attributes:
        is_standing: whether it publishes the same time again and again.
    """

    def __init__(self, speed: float) -> None:
        super().__init__("free_clock")
        self.is_standing = False
        self._now_ns = 100 * 10**9
        self._step_ns = round(1e9 * PERIOD_S * speed)
        self._leap_ns = 0
        self._publisher = self.node.create_publisher(
            Clock, "/clock", QoSProfile(history=HistoryPolicy.KEEP_ALL)
        )
        self._stop = threading.Event()
        self._ticks = threading.Thread(target=self._run, daemon=True)
        self._ticks.start()

    def now_ns(self) -> int:
        """Return the time that was published last."""
        return self._now_ns

    def jump(self, seconds: float) -> None:
        """Go on from another time; it is published next."""
        self._leap_ns = round(1e9 * seconds)

    def close(self) -> None:
        """Leave the graph."""
        self._stop.set()
        self._ticks.join()
        super().close()

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stop.wait(max(0.0, due_s - time.monotonic())):
            due_s += PERIOD_S
            leap_ns, self._leap_ns = self._leap_ns, 0
            self._now_ns += leap_ns
            if not self.is_standing:
                self._now_ns += self._step_ns
            self._publisher.publish(Clock(clock=msg_adapters.encode_stamp(self._now_ns)))


def free_clock(*, speed: float) -> AbstractContextManager[FreeClock]:
    """Let time run in the block."""
    return closing(FreeClock(speed))
