# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports how far a long computation is."""

from __future__ import annotations

import sys
import time

SHOWN_PARTS = 10
"""So many times a step is printed."""

TOLD_FROM = 0.25
TOLD_AFTER_S = 60.0
"""The time left is told once this share of a step is done, or it has gone on for so long: what
several workers have begun and not finished makes the first rates too low."""


class PrintedProgress:
    """Prints each step's share and the time that is left of it, at the rate that it went so far."""

    def __init__(self) -> None:
        self._step, self._begun_s, self._begun_at, self._shown = "", 0.0, 0, 0

    def __call__(self, step: str, done: int, total: int) -> None:
        now_s = time.monotonic()
        if step != self._step:
            self._step, self._begun_s, self._begun_at, self._shown = step, now_s, done, 0
        part = SHOWN_PARTS if done >= total else SHOWN_PARTS * done // total
        if part == self._shown or not done:
            return
        self._shown = part
        went, took_s = done - self._begun_at, now_s - self._begun_s
        # Of the first that is told the duration is not known.
        is_known = went > 0 and (done >= TOLD_FROM * total or took_s >= TOLD_AFTER_S)
        left = f", {took_s / went * (total - done):.0f} s left" if is_known else ""
        print(f"{step}: {done}/{total}{left}", file=sys.stderr, flush=True)


NOTICED_FROM_S = 2.0
"""Who waits for less needs no explanation."""


def say_first_time(what: str, seconds: float) -> None:
    """Print on stderr what is computed for the first time, and how long it takes."""
    print(
        f"dotsim_ros: {what} for the first time, about {seconds:.0f} s; the result is kept",
        file=sys.stderr,
        flush=True,
    )


class FirstTimeNotice:
    """Says once that something is computed, if by the rate of its parts that takes a while.

    Args:
        what: is done, such as "computing tables".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._first: tuple[float, float] | None = None
        self._is_said = False

    def __call__(self, share: float) -> None:
        now_s = time.monotonic()
        if self._first is None:
            # What came before the first part is not part of the rate.
            self._first = share, now_s
            return
        if self._is_said:
            return
        self._is_said = True
        first_share, first_s = self._first
        left_s = (now_s - first_s) / max(share - first_share, 1e-9) * (1.0 - share)
        if left_s > NOTICED_FROM_S:
            say_first_time(self._what, left_s)


def bar(share: float, note: str) -> str:
    """Return a bar that shows how much is done, and what else is to be said."""
    done = round(30 * min(1.0, max(0.0, share)))
    return f"[{'#' * done}{'.' * (30 - done)}] {note}"
