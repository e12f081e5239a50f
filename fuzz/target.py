# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a target of the fuzzer is, and how an answer is judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, TypeVar

LONGEST_ANSWER = 2000

Result = TypeVar("Result")


class Finding(Exception):  # noqa: N818
    """An answer that a user should not have met."""


@dataclass(frozen=True)
class Target:
    """Something that takes input.

    Attributes:
        name: for the command line.
        prepare: makes what all cases need in a folder of its own, once; its answer goes to each.
        attempt: one case: what `prepare` gave, the case's random numbers, an empty folder.
    """

    name: str
    prepare: Callable[[Path], Any]
    attempt: Callable[[Any, Random, Path], None]


def answer(run: Callable[[], Result], names: Sequence[str]) -> Result | None:
    """Return what a reader gives; None where it refuses as it should.

    Args:
        run: reads.
        names: the files or fields of which the refusal must name at least one.

    Raises:
        Finding: it refuses in words that do not help. Other exceptions go through.
    """
    try:
        return run()
    except (ValueError, OSError) as error:
        words = str(error)
        if not any(name in words for name in names):
            raise Finding(f"names none of {', '.join(names)}: {words!r}") from error
        if "\n" in words.strip():
            raise Finding(f"more than a line: {words!r}") from error
        if len(words) > LONGEST_ANSWER:
            raise Finding(f"{len(words)} characters: {words[:200]!r}...") from error
        if "pickle" in words:
            raise Finding(f"speaks of pickles: {words!r}") from error
        return None
