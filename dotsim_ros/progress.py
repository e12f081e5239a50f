"""Reports how far a long computation is."""

from __future__ import annotations

import sys
import time


class PrintedProgress:
    """Prints each step's share and the time that is left of it."""

    def __init__(self) -> None:
        self._step, self._begun_s = "", 0.0

    def __call__(self, step: str, done: int, total: int) -> None:
        now_s = time.monotonic()
        if step != self._step:
            self._step, self._begun_s = step, now_s
        if done and (done == total or done % max(1, total // 10) == 0):
            left_s = (now_s - self._begun_s) / done * (total - done)
            print(f"{step}: {done}/{total}, {left_s:.0f} s left", file=sys.stderr, flush=True)


def bar(share: float, note: str, *, width: int = 30) -> str:
    """Return a bar that shows how much is done, and what else is to be said."""
    done = round(width * min(1.0, max(0.0, share)))
    return f"[{'#' * done}{'.' * (width - done)}] {note}"
