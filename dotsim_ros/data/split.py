# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which presses a model is fitted on, and which it is judged on."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import numpy as np

from dotsim_ros.data.data_set import DataSetEntry

HELD_OUT_COUNT = 9


def usual_hold_out(count: int) -> int:
    """Return on how many of so many trajectories a fit is judged."""
    return HELD_OUT_COUNT if count > HELD_OUT_COUNT else 0


def split_of(
    entries: Sequence[DataSetEntry],
    *,
    leave_out: Collection[str] = (),
    hold_out: int | None = None,
    seed: int = 0,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the sorted names of the trajectories to fit on and to judge on.

    Args:
        entries: the trajectories.
        leave_out: indenters to judge on; empty to draw trajectories.
        hold_out: how many are drawn; None for the usual number, 0 for none.
        seed: of the draw: gel, camera and network are judged on the same.

    Raises:
        ValueError: an unknown indenter, or nothing left to fit on or to judge on.
    """
    indenter_of = {entry.name: entry.indenter for entry in entries}
    names = sorted(indenter_of)
    if leave_out:
        known = set(indenter_of.values())
        train = tuple(name for name in names if indenter_of[name] not in leave_out)
        held_out = tuple(name for name in names if indenter_of[name] in leave_out)
        if not train or not held_out or not set(leave_out) <= known:
            raise ValueError(
                f"to leave out {', '.join(leave_out)} leaves {len(train)} trajectories to fit on "
                f"and {len(held_out)} to judge on; indenters are {', '.join(sorted(known))}: name "
                "some of them, not all"
            )
        return train, held_out
    count = usual_hold_out(len(names)) if hold_out is None else hold_out
    return hold_out_of_protocols(names, count, seed) if count else (tuple(names), ())


def hold_out_of_protocols(
    names: Iterable[str], count: int = HELD_OUT_COUNT, seed: int = 0
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return (train, test), sorted: a stratified draw by a seed.

    Names that differ in the number at their end alone are repeats of one protocol. Some of every
    protocol stay to fit on, and, as far as `count` goes, one of every protocol is judged on: a draw
    that holds out every slide leaves no data that identify friction, one without a slide does not
    judge it.

    Raises:
        ValueError: a name twice, a count that leaves nothing to fit on or to judge on, or more to
            hold out than there are repeats.
    """
    ordered = sorted(names)
    twice = sorted({n for n in ordered if ordered.count(n) > 1})
    if twice:
        raise ValueError(f"names of presses must differ, got {', '.join(twice)} more than once")
    if not 0 < count < len(ordered):
        raise ValueError(
            f"{count} of {len(ordered)} presses cannot be held out; expected 1 to "
            f"{len(ordered) - 1}"
        )
    random = np.random.default_rng(seed)
    repeats = repeats_of(ordered)
    for members in repeats.values():
        random.shuffle(members)
    # The last of each protocol is never drawn; the first of each goes before all seconds.
    ranked = [
        (place, random.random(), name)
        for members in repeats.values()
        for place, name in enumerate(members[:-1])
    ]
    if len(ranked) < count:
        raise ValueError(
            f"{count} of {len(ordered)} presses cannot be held out so that some of each of "
            f"{len(repeats)} protocols stay to fit on; hold out {len(ranked)} at most, or record "
            "repeats"
        )
    test = {name for _, _, name in sorted(ranked)[:count]}
    return tuple(n for n in ordered if n not in test), tuple(n for n in ordered if n in test)


def repeats_of(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the sorted names by protocol: those that differ in the number at their end alone."""
    repeats: dict[str, list[str]] = {}
    for name in sorted(names):
        repeats.setdefault(name.rstrip("0123456789").rstrip("_"), []).append(name)
    return repeats
