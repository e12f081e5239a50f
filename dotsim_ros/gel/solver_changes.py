# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One gel with several solvers, of which one is at work: by turns, without losing the contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dotsim_ros.gel.implicit.handover import Handover
from dotsim_ros.gel.make import Gel, SingleImplicitGel
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.specification import SolverSpecification


class SolverChanges:
    """The gels of one sensor, one for each grid.

    Solvers that differ in tolerance and iterations alone share a gel.

    Args:
        gel: the first one.
        solver: its own.

    Attributes:
        gel: the one at work.
    """

    def __init__(self, gel: Gel, solver: SolverSpecification) -> None:
        self.gel = gel
        self._gels = {_grid_of(solver): gel}
        self._handovers: dict[tuple[int, int], Handover] = {}

    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter of all gels and return to rest.

        Raises:
            ValueError: a gel refuses it, the first one before anything is changed.
        """
        for gel in self._gels.values():
            gel.set_indenter(indenter)

    def prepare(self, solver: SolverSpecification, make: Callable[[], Gel]) -> None:
        """Make the gel of a solver's grid, and what carries the state to it and back, where it
        does not exist.

        Raises:
            ValueError: a gel cannot hand over what it remembers.
        """
        grid = _grid_of(solver)
        if grid in self._gels:
            return
        new = make()
        handovers = {}
        for other in self._gels.values():
            for source, target in ((other, new), (new, other)):
                handovers[id(source), id(target)] = _handover(source, target)
        self._handovers |= handovers
        self._gels[grid] = new

    def change(self, solver: SolverSpecification, *, largest_jump_m: float) -> float:
        """Go on with a solver that is prepared; return how far a marker jumped.

        Raises:
            SkinJumpError: it would jump farther; the gel at work stays.
        """
        target = self._gels[_grid_of(solver)]
        jump_m = 0.0
        if target is not self.gel:
            handover = self._handovers[id(self.gel), id(target)]
            jump_m = handover.carry(largest_jump_m=largest_jump_m)
        if isinstance(target, SingleImplicitGel):
            target.gel.solver = solver
        self.gel = target
        return jump_m


def _grid_of(solver: SolverSpecification) -> SolverSpecification:
    """Return what of a solver decides the gel's tables: all but its effort."""
    any_effort = SolverSpecification()
    return replace(
        solver,
        tolerance_m=any_effort.tolerance_m,
        iterations=any_effort.iterations,
        friction_passes=any_effort.friction_passes,
    )


def _handover(source: Gel, target: Gel) -> Handover:
    if not (isinstance(source, SingleImplicitGel) and isinstance(target, SingleImplicitGel)):
        raise ValueError("only implicit gels hand over their state")
    return Handover(source.gel, target.gel)
