# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Who may take the next step of time: a thread takes steps, and others let it or stop it."""

from __future__ import annotations

from enum import StrEnum
from threading import Condition

from rclpy.task import Future


class Turn(StrEnum):
    """Why the next step is taken."""

    RUN = "time runs"
    ASKED = "somebody asked for a step"
    END = "no further step is taken"


class StepControl:
    """Passes the turns. All methods may be called from any thread.

    Args:
        is_paused: whether steps are taken on request only.
    """

    def __init__(self, *, is_paused: bool) -> None:
        self._changed = Condition()
        self._is_paused = is_paused
        self._is_ended = self._is_stepping = False
        self._left = 0
        self._asked: Future | None = None
        self._holds = 0
        self._standing: list[Future] = []

    @property
    def is_paused(self) -> bool:
        """Return whether steps are taken on request only."""
        return self._is_paused

    def pause(self, wanted: bool) -> None:
        """Let time run, or stop it after the present step."""
        with self._changed:
            self._is_paused = wanted
            self._changed.notify_all()

    def ask(self, count: int) -> Future:
        """Ask for steps; return what is done when they are taken.

        Raises:
            ValueError: time runs, or others are still being taken.
        """
        with self._changed:
            if not self._is_paused:
                raise ValueError("time runs: pause it first")
            if self._left:
                raise ValueError(f"{self._left} steps asked for before are still to be taken")
            self._left, self._asked = count, Future()
            self._changed.notify_all()
            return self._asked

    def hold(self) -> Future:
        """Let no step begin until `release`; return what is done once none is being taken."""
        with self._changed:
            self._holds += 1
            standing = Future()
            if self._is_stepping:
                self._standing.append(standing)
            else:
                standing.set_result(None)
            return standing

    def release(self) -> None:
        """Undo one `hold`."""
        with self._changed:
            self._holds -= 1
            self._changed.notify_all()

    def end(self) -> None:
        """Let no further step be taken."""
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()

    def begin_step(self) -> Turn:
        """Wait for a turn."""
        with self._changed:
            self._changed.wait_for(self._has_turn)
            if self._is_ended:
                return Turn.END
            self._is_stepping = True
            return Turn.ASKED if self._left else Turn.RUN

    def end_step(self, turn: Turn) -> None:
        """Say that the step of a turn is taken."""
        with self._changed:
            self._is_stepping = False
            if turn is Turn.ASKED:
                self._left -= 1
            done, self._standing = self._standing, []
            if self._asked is not None and not self._left:
                done.append(self._asked)
                self._asked = None
        for each in done:
            each.set_result(None)

    def rest(self, seconds: float) -> None:
        """Wait, less where time is stopped meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_ended or self._is_paused, seconds)

    def _has_turn(self) -> bool:
        may_step = not self._is_paused or self._left > 0
        return self._is_ended or (may_step and not self._holds)
