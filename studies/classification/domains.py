# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which measured frames the image models are fitted on, and which classifiers are judged on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

from studies.optics.split import FrameKey, Recorded, frames_of, sorted_with_unseen

DomainName = Literal["in_domain", "out_of_domain", "all_six"]
DOMAINS: tuple[DomainName, ...] = get_args(DomainName)
"""The last takes all indenters, of which the stand-in for a real sensor has six."""
FOLDS = 2


@dataclass(frozen=True)
class Fold:
    """Frames to fit on and to judge on, of different trajectories.

    Attributes:
        fitted: whole trajectories, for the image model.
        judged: frames of the classes; those without contact are left out later.
    """

    fitted: tuple[FrameKey, ...]
    judged: tuple[FrameKey, ...]


@dataclass(frozen=True)
class Domain:
    """A task of classification.

    Attributes:
        name: one of `DOMAINS`.
        classes: names of the indenters, sorted.
        folds: every frame of the classes is judged in one of them.
    """

    name: str
    classes: tuple[str, ...]
    folds: tuple[Fold, ...]


def domain_of(name: str, trajectories: Iterable[Recorded]) -> Domain:
    """Return a domain of recorded trajectories.

    In the domain, an image model is fitted on half of the classes' trajectories and judged on the
    others, then the other way round. Out of the domain it is fitted on the other indenters alone.

    Args:
        name: one of `DOMAINS`.
        trajectories: those that hold images.

    Raises:
        ValueError: as `sorted_with_unseen`, or an indenter with a single trajectory.
    """
    ordered, two = sorted_with_unseen(trajectories)
    if name == "out_of_domain":
        apart = [trajectory for trajectory in ordered if trajectory.indenter in two]
        others = [trajectory for trajectory in ordered if trajectory.indenter not in two]
        return Domain(name, two, (Fold(frames_of(others), frames_of(apart)),))
    everything = tuple(sorted({trajectory.indenter for trajectory in ordered}))
    classes = everything if name == "all_six" else two
    part_of: dict[str, int] = {}
    for indenter in classes:
        own = [trajectory.name for trajectory in ordered if trajectory.indenter == indenter]
        if len(own) < FOLDS:
            raise ValueError(f"{indenter} has {len(own)} trajectory, expected {FOLDS} at least")
        part_of |= {trajectory: rank % FOLDS for rank, trajectory in enumerate(own)}
    members = [trajectory for trajectory in ordered if trajectory.name in part_of]
    return Domain(
        name,
        classes,
        tuple(
            Fold(
                frames_of([t for t in members if part_of[t.name] != part]),
                frames_of([t for t in members if part_of[t.name] == part]),
            )
            for part in range(FOLDS)
        ),
    )
