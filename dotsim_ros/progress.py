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


def bar(share: float, note: str, *, width: int = 30) -> str:
    """Return a bar that shows how much is done, and what else is to be said."""
    done = round(width * min(1.0, max(0.0, share)))
    return f"[{'#' * done}{'.' * (width - done)}] {note}"
