# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Work that many tests ask for in the same words and that one process need do but once.

Each function gives what it gave for the same content before; nothing else of it changes. Arrays
that several gels hold cannot be written to.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.data import data_set
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit import gel, rest_compliance, tangent
from dotsim_ros.gel.implicit.tangent import inverse_at_rest, inverse_of_positive
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.io.cache import content_key

KEPT_GRIDS = 8
KEPT_INVERSES = 3
"""A shipped gel's takes 80 MB."""
LEAST_ROWS = 1500
"""A smaller matrix is inverted in less time than it takes to look it up."""


class Kept:
    """The last few answers of a function, by what was asked."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._answers: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the answer to a key, made if it is not there."""
        if key not in self._answers:
            self._answers[key] = make()
            if len(self._answers) > self._count:
                self._answers.popitem(last=False)
        self._answers.move_to_end(key)
        return self._answers[key]


def share(patch: pytest.MonkeyPatch) -> None:
    """Let gels and data sets of this process share their grids, inverses and meshes."""
    grids, inverses, meshes = Kept(KEPT_GRIDS), Kept(KEPT_INVERSES), Kept(32)

    def kept_grid(body: Any, skin_position_m: np.ndarray, spacing_m: float) -> Any:
        key = content_key((), body, skin_position_m, spacing_m)
        return grids.get(key, lambda: discretize(body, skin_position_m, spacing_m))

    def kept_inverse(matrix: np.ndarray) -> np.ndarray:
        if len(matrix) < LEAST_ROWS:
            return inverse_of_positive(matrix)
        # Symmetric: its rows are its columns.
        key = content_key((), matrix.T)
        inverse: np.ndarray = inverses.get(key, lambda: inverse_of_positive(matrix))
        inverse.flags.writeable = False
        return inverse

    def own_inverse(body: ElasticBody) -> np.ndarray:
        # Who keeps a table scales it in place.
        return inverse_at_rest(body).copy()

    def kept_indenter(path: Path | str, folder: Path | None = None) -> Indenter:
        if isinstance(path, str):
            return load_indenter(path, folder=folder)
        key = content_key((), path.name, path.read_bytes())
        mesh: Indenter = meshes.get(key, lambda: load_indenter(path))
        return mesh

    patch.setattr(gel, "discretize", kept_grid)
    patch.setattr(tangent, "inverse_of_positive", kept_inverse)
    patch.setattr(rest_compliance, "inverse_at_rest", own_inverse)
    patch.setattr(data_set, "load_indenter", kept_indenter)
