# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which trajectories with images a camera or a network is fitted on, and which it is judged on."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path


def filmed_split(
    data: Path,
    *,
    trajectories: Collection[str],
    leave_out: Collection[str],
    hold_out: int | None,
    usual: Callable[[int], int],
    seed: int,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the sorted names of the trajectories to fit on and to judge on.

    Args:
        data: folder of the data set.
        trajectories: to use; empty for all with images.
        leave_out: indenters to judge on; empty to draw trajectories.
        hold_out: how many are drawn; None for the usual number, 0 for none.
        usual: how many of so many trajectories are drawn.
        seed: of the draw, which is that of `dotsim_ros calibrate`: neither gel nor camera has seen
            what is judged.

    Raises:
        ValueError: no images, an unknown trajectory or indenter, or nothing left to fit on.
    """
    from dotsim_ros.data.data_set import read_data_set
    from dotsim_ros.data.split import hold_out_of_protocols

    filmed = {e.name: e.indenter for e in read_data_set(data).entries if e.has_images}
    if not filmed:
        raise ValueError(f"{data} says that none of its trajectories holds images")
    names = sorted(trajectories or filmed)
    unknown = sorted(set(names) - set(filmed))
    if unknown:
        raise ValueError(f"{data} has no trajectory with images named {', '.join(unknown)}")
    if leave_out:
        known = {filmed[name] for name in names}
        if set(leave_out) >= known or not set(leave_out) <= known:
            raise ValueError(
                f"--leave-out {' '.join(leave_out)}: indenters are {', '.join(sorted(known))}; "
                "name some of them, not all"
            )
        held_out = tuple(name for name in names if filmed[name] in leave_out)
        return tuple(name for name in names if name not in held_out), held_out
    count = usual(len(names)) if hold_out is None else hold_out
    return hold_out_of_protocols(names, count, seed) if count else (tuple(names), ())
