# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node reports of the clock that it follows."""

from dotsim_ros.nodes.common.clock_watch import SILENT_S, ClockJump, ClockWatch
from dotsim_ros.nodes.common.health import FAULT_MEMORY_S
from msg_adapters import Level

SECOND = 1_000_000_000


def test_a_clock_that_never_spoke_and_one_that_fell_silent_are_warned_of():
    watch = ClockWatch(0.0)
    level, message, values = watch.report(1.0)
    assert (level, values["silence_s"]) == (Level.WARN, "1.00")
    assert "/clock is silent" in message
    watch.move(1.0)
    assert watch.report(0.9 + SILENT_S)[:2] == (Level.OK, "running")
    level, message, _ = watch.report(1.5 + SILENT_S)
    assert level is Level.WARN
    assert message.startswith("/clock has not moved on for 2.5 s")


def test_a_leap_is_warned_of_for_a_while_and_a_return_is_named():
    watch = ClockWatch(0.0)
    watch.move(1.0)
    watch.jump(ClockJump(5 * SECOND, 15 * SECOND, 10 * SECOND), 1.0)
    level, message, values = watch.report(1.1)
    assert (level, values["leaps"], values["restarts"]) == (Level.WARN, "1", "0")
    assert "leapt forward by 10.000 s" in message
    watch.jump(ClockJump(15 * SECOND, 5 * SECOND, -10 * SECOND), 1.2)
    level, message, values = watch.report(1.3)
    assert (level, values["leaps"], values["restarts"]) == (Level.OK, "1", "1")
    assert "went back by 10.000 s: a new start" in message
    watch.move(1.2 + FAULT_MEMORY_S)
    assert watch.report(1.3 + FAULT_MEMORY_S)[:2] == (Level.OK, "running")
