# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes a data set of touches with many workers, and goes on where it was ended."""

from __future__ import annotations

import json
import math
import shutil
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dotsim_ros.data.lerobot.writer import check_installed
from dotsim_ros.io.cache import content_key
from dotsim_ros.io.documents import read_json, value_text
from dotsim_ros.io.files import write_image, write_json
from dotsim_ros.io.provenance import provenance
from dotsim_ros.io.worker_pool.pool import Crew, open_pool, worker_count
from dotsim_ros.learning.touches.formats import FIELD_WIDTH_PX, FORMATS, LEROBOT
from dotsim_ros.learning.touches.making import Touch, TouchMaker
from dotsim_ros.learning.touches.plan import VERSION, TouchPlan
from dotsim_ros.learning.touches.sheet import thumbnail_of, write_sheet

CARD = "touches.json"
THUMBNAILS = ".thumbnails"
AHEAD = 3
"""Groups for each worker that are made before the first of them is written."""


@dataclass(frozen=True)
class Made:
    """What a data set holds, and its contact sheet."""

    touches: int
    frames: int
    sheet: Path


def make_touches(
    plan: TouchPlan,
    folder: Path,
    *,
    count: int,
    seed: int = 0,
    kind: str = LEROBOT,
    workers: Crew = 1,
    progress: Callable[[str, int, int], None],
) -> Made:
    """Make the touches that a folder does not hold yet.

    It starts processes, so a script calls it below `if __name__ == "__main__":`.

    Args:
        plan: what is touched.
        folder: of the data set.
        count: touches in all.
        seed: of all draws.
        kind: of `FORMATS`.
        workers: who makes them.
        progress: called with what is done, how much of it, and of how much.

    Raises:
        ValueError: the folder holds another data set, or the plan draws what no gel takes.
        OSError: no room, or a worker was ended; what is written stays.
    """
    if kind == LEROBOT:
        check_installed()
    if count < 1:
        raise ValueError(f"{count} touches, expected 1 or more")
    _keep_card(folder, plan, count, seed, kind)
    for half_written in folder.rglob(".part.*"):
        shutil.rmtree(half_written, ignore_errors=True)
    written = FORMATS[kind](folder, plan)
    group_count = math.ceil(count / plan.touches_a_gel)
    missing = [number for number in range(group_count) if not written.holds(number)]
    done = sum(len(_numbers(number, plan, count)) for number in range(group_count))
    done -= sum(len(_numbers(number, plan, count)) for number in missing)
    progress("touches", done, count)
    with open_pool(workers, _begin, plan, seed, FIELD_WIDTH_PX[kind]) as pool:
        pieces = _in_order(pool, [_numbers(n, plan, count) for n in missing], worker_count(workers))
        for number, touches in zip(missing, pieces, strict=True):
            for touch in touches:
                write_image(_thumbnail(folder, touch.number), thumbnail_of(touch))
            written.add(number, touches)
            done += len(touches)
            progress("touches", done, count)
    sheet = write_sheet(folder, [_thumbnail(folder, number) for number in range(count)])
    return Made(count, count * plan.frames, sheet)


def _numbers(group: int, plan: TouchPlan, count: int) -> list[int]:
    """Return the numbers of a group's touches."""
    first = group * plan.touches_a_gel
    return list(range(first, min(count, first + plan.touches_a_gel)))


def _thumbnail(folder: Path, number: int) -> Path:
    return folder / THUMBNAILS / f"{number:06d}.jpg"


def _keep_card(folder: Path, plan: TouchPlan, count: int, seed: int, kind: str) -> None:
    """Write what the data set is of, or see that what is there is of the same.

    Raises:
        ValueError: it is of another plan, or the folder holds something else.
    """
    card = {
        "version": VERSION,
        "plan": json.loads(json.dumps(plan.document)),
        "touches": count,
        "seed": seed,
        "format": kind,
        # Names do not tell sensors and indenters apart.
        "content": content_key((), plan.sensor, plan.indenters),
    }
    path = folder / CARD
    if path.is_file():
        known: Any = read_json(path)
        known = known if isinstance(known, dict) else {}
        if known.get("version") != VERSION:
            raise ValueError(
                f"{path} is of the version {value_text(known.get('version'))}, expected {VERSION}; "
                "give another folder with --out"
            )
        differs = [name for name, value in card.items() if known.get(name) != value]
        if "plan" in differs and "content" in differs:
            differs.remove("content")
        differs = ["number" if name == "touches" else name for name in differs]
        if differs:
            raise ValueError(
                f"{folder} holds touches of another {' and '.join(differs)}; give another folder "
                "with --out, or remove it to make them again"
            )
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder} holds something else than touches; give another with --out")
    write_json(path, card | {"origin": provenance()})


def _in_order(
    pool: Executor, pieces: Sequence[Sequence[int]], workers: int
) -> Iterator[list[Touch]]:
    """Yield the touches of pieces in their order, a few of which are made ahead."""
    waiting = deque(pieces)
    making: deque[Future[list[Touch]]] = deque()
    while waiting or making:
        while waiting and len(making) < AHEAD * workers:
            making.append(pool.submit(_make, waiting.popleft()))
        yield making.popleft().result()


_maker: TouchMaker | None = None


def _begin(plan: TouchPlan, seed: int, field_width_px: int) -> None:
    global _maker
    _maker = TouchMaker(plan, seed, field_width_px)


def _make(numbers: Sequence[int]) -> list[Touch]:
    assert _maker is not None
    return [_maker.touch(number) for number in numbers]
