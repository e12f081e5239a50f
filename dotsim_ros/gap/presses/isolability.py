# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which effects the protocols distinguish, and which one does so best (step 7 of the method)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import Effect
from dotsim_ros.gap.findings import Pair
from dotsim_ros.gap.presses.inference import Evidence, cosines, lengths
from dotsim_ros.io.arrays import FloatArray


def pairs_of(
    evidence: Evidence,
    effects: Sequence[Effect],
    columns: FloatArray,
    recordings: Sequence[Recording],
) -> tuple[Pair, ...]:
    """Return every pair of effects.

    Args:
        evidence: whose nuisances are projected out.
        effects: k of them.
        columns: (n, k) whitened change by each.
        recordings: of the evidence's trajectories, in order.
    """
    apart = _separations(evidence, columns)
    rho = cosines(evidence, columns)
    duration_s = np.array([float(np.ptp(r.press.stamp_s)) for r in recordings])
    by_trajectory = np.stack(
        [
            _separations(evidence.of([t]), columns[evidence.rows_of([t])])
            for t in range(len(recordings))
        ]
    )
    per_second = by_trajectory / duration_s[:, None, None]
    pairs = []
    for i, first in enumerate(effects):
        for j, second in enumerate(effects[i + 1 :], start=i + 1):
            best = int(np.argmax(per_second[:, i, j]))
            pairs.append(
                Pair(
                    first.name,
                    second.name,
                    float(rho[i, j]),
                    float(apart[i, j]),
                    "; or ".join(dict.fromkeys((first.protocol, second.protocol))),
                    recordings[best].name,
                    float(per_second[best, i, j]),
                )
            )
    return tuple(pairs)


def _separations(evidence: Evidence, columns: FloatArray) -> FloatArray:
    """Return (k, k) d = delta sqrt((1 - |rho|) / 2), delta being the larger of the two sizes."""
    size, rho = lengths(evidence, columns), cosines(evidence, columns)
    delta = np.maximum(size[:, None], size[None, :])
    return np.asarray(delta * np.sqrt(np.maximum(1.0 - np.abs(rho), 0.0) / 2.0))
