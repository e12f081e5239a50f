# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_sim` counts of its frames, and reports of its gel. Needs no ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from dotsim_ros.nodes.common.counters import RateMeter
from dotsim_ros.nodes.common.health import FAULT_MEMORY_S, Report
from msg_adapters import Level

if TYPE_CHECKING:
    from dotsim_ros.gel.make import GelFrame

SPENT_FRAME_COUNT = 1500
"""A minute at 25 Hz."""
GROUPS = {"gel": ("contact", "solve"), "optics": ("depth", "image")}


class FrameCounter:
    """Counts frames, and where their time went; one thread may count while another one reads.

    Attributes:
        rate: of the frames.
        unconverged: how many of them have a gel that had not converged.
        last_unconverged_s: when the last of these was.
    """

    def __init__(self) -> None:
        self.rate = RateMeter()
        self.unconverged = 0
        self.last_unconverged_s = -np.inf
        self._lock = Lock()
        self._spent_s: deque[Mapping[str, float]] = deque(maxlen=SPENT_FRAME_COUNT)

    def note(self, now_s: float, spent_s: Mapping[str, float], *, converged: bool) -> None:
        """Count a frame that took `spent_s` by part."""
        self.rate.note(now_s)
        with self._lock:
            if not converged:
                self.unconverged += 1
                self.last_unconverged_s = now_s
            self._spent_s.append(spent_s)

    def p95_ms(self) -> dict[str, float]:
        """Return the 95th percentile of each part and group, of the newest frames."""
        with self._lock:
            frames = list(self._spent_s)
        spent_s = {
            part: np.array([frame.get(part, 0.0) for frame in frames])
            for part in sorted({part for frame in frames for part in frame})
        }
        for group, parts in GROUPS.items():
            if spent_s.keys() >= set(parts):
                spent_s[group] = np.sum([spent_s[part] for part in parts], axis=0)
        return {part: 1e3 * float(np.percentile(each, 95)) for part, each in spent_s.items()}


def lag_text(lag_m: float, maximum_lag_m: float) -> str:
    """Return in words that the indenter lags behind."""
    return (
        f"the indenter is {1e3 * lag_m:.2f} mm behind its newest pose, more than maximum_lag_m, "
        f"{maximum_lag_m:g} m: it moves faster than the frames can follow in contact; move it more "
        "slowly, raise rate_hz where the machine allows, or use simulated time"
    )


def gel_report(
    gel: GelFrame, effects: Sequence[str], counter: FrameCounter, now_s: float
) -> Report:
    """Return the state of the gel of the newest frame, and of those not long before it."""
    values = {
        "max_penetration_um": f"{1e6 * gel.max_penetration_m:.2f}",
        "converged": str(gel.converged).lower(),
        "unconverged": str(counter.unconverged),
        "force_n": f"{float(np.linalg.norm(gel.wrench.force_n)):.4f}",
        "effects": ", ".join(effects) or "none",
    }
    # One frame among the many between two reports must not pass unseen.
    if not gel.converged or now_s - counter.last_unconverged_s < FAULT_MEMORY_S:
        return Level.WARN, "the equilibrium of a frame has not converged", values
    return Level.OK, "in equilibrium", values
