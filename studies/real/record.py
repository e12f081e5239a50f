# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""All real data of gels and of a DenseTact, in one record."""

from __future__ import annotations

from typing import Any

from studies.optics.real_pair import real_pair
from studies.real.altered import real_gap
from studies.real.cylinder_study import real_cylinders
from studies.real.pad_study import real_force


def real() -> dict[str, Any]:
    """Real forces, cylinders, altered recordings and one real image, each as its own study."""
    return {
        "force": real_force(),
        "cylinders": real_cylinders(),
        "gap": real_gap(),
        "pair": real_pair(),
    }
