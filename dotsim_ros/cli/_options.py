# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options that several verbs have: types that check what is given, workers, topics, progress."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter
from cyclopts.validators import mutually_exclusive

from dotsim_ros.io.progress import bar

if TYPE_CHECKING:
    from dotsim_ros.data.trajectory import Topics
    from dotsim_ros.io.worker_pool.pool import Crew


def within(least: float, greatest: float, kind: type[float] = float) -> Parameter:
    """Return what lets an option take numbers of a range, whole ones where `kind` is int."""
    noun = "a whole number" if kind is int else "a number"

    def convert(_: Any, tokens: Sequence[Any]) -> float:
        text = tokens[0].value
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= greatest:
            is_bounded = math.isfinite(greatest)
            expected = f" from {least:g} to {greatest:g}" if is_bounded else ""
            raise ValueError(f"{text} is not {noun}{expected}")
        return value

    return Parameter(converter=convert)


Whole = Annotated[int, within(-math.inf, math.inf, int)]
"""An int: cyclopts alone would round a fraction."""
NoSeed = Annotated[Whole, Parameter(help="accepted; nothing here is random.")]
Meshes = Annotated[
    Path | None,
    Parameter(help="folder of the indenters' meshes; without it in the data set, then next to it."),
]
Judged: Any = Group("Judged on, either", validator=mutually_exclusive)
"""Of options that say what a fit is judged on."""


@Parameter(name="*")
@dataclass(frozen=True)
class WorkerOptions:
    """Who does the work.

    Attributes:
        workers: processes, or with --ray-address workers of the cluster, at most.
        ray_address: work on a Ray cluster: HOST:PORT of its head; auto, the one that this machine
            is part of; local, Ray on this machine alone. Without it processes of this machine work.
    """

    workers: Whole = 2
    ray_address: str | None = None

    def crew(self) -> Crew:
        """Return the workers that were asked for.

        Raises:
            ValueError: no worker, or an address of another form.
        """
        from dotsim_ros.io.worker_pool.pool import crew

        return crew(self.workers, self.ray_address)


HERE = WorkerOptions()


def topics_of(**given: str | None) -> Topics:
    """Return the topics of a data set, of which some are named."""
    from dotsim_ros.data.trajectory import Topics

    return Topics(**{name: topic for name, topic in given.items() if topic is not None})


def show_stage(stage: str, done: int, total: int) -> None:
    """Draw a bar on a terminal; elsewhere print each stage's beginning and end."""
    if sys.stderr.isatty():
        redraw(bar(done / max(total, 1), f"{done}/{total} {stage}"), is_last=done == total)
    elif done in (0, total):
        say(f"{stage}: {done}/{total}")


def redraw(line: str, *, is_last: bool) -> None:
    """Print a line over the one before on a terminal; elsewhere below it."""
    is_terminal = sys.stderr.isatty()
    end = "" if is_terminal and not is_last else "\n"
    print(f"\r{line}" if is_terminal else line, end=end, file=sys.stderr, flush=True)


def say(line: object) -> None:
    """Print a line of progress, next to the results."""
    print(line, file=sys.stderr, flush=True)
