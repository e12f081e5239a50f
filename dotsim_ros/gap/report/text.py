# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers of a gap's report in words and in units that are easy to read."""

from __future__ import annotations

import numpy as np

from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.findings import Findings, OpticalFindings

_SHOWN_UNITS = {
    "m": (1e3, "mm"),
    "m/N": (1e3, "mm/N"),
    "s": (1.0, "s"),
    "Pa": (1e-3, "kPa"),
    "rad": (180.0 / np.pi, "degrees"),
}


def shown(value: float, unit: str) -> float:
    """Return a value of an SI unit in the unit that `shown_unit` names."""
    return float(value * _SHOWN_UNITS.get(unit, (1.0, unit))[0])


def shown_unit(unit: str) -> str:
    """Return the unit in which a report shows values of an SI unit."""
    return _SHOWN_UNITS.get(unit, (1.0, unit))[1]


def shown_name(name: str, unit: str) -> str:
    """Return a parameter's name without its SI unit, which may not be the one that is shown."""
    return name.removesuffix(f"_{unit.replace('/', '_').lower()}")


def quantity(value: float, unit: str) -> str:
    """Return a value with its unit."""
    return f"{shown(value, unit):.3g} {shown_unit(unit)}".rstrip()


def estimate_text(estimate: Estimate) -> str:
    """Return a fitted number with its interval."""
    return _with_range(estimate, "")


def with_prior_text(estimate: Estimate) -> str:
    """Return a fitted number with the range of its prior, where that is what its ends are."""
    return _with_range(estimate, "prior ")


def _with_range(estimate: Estimate, range_name: str) -> str:
    low, high = (f"{shown(end, estimate.unit):.3g}" for end in (estimate.low, estimate.high))
    value = f"{shown(estimate.value, estimate.unit):.3g}"
    name = shown_name(estimate.name, estimate.unit)
    unit = shown_unit(estimate.unit)
    return f"{name} = {value} ({range_name}{low} to {high}) {unit}".rstrip()


def percent(share: float | None) -> str:
    """Return a share in percent, a dash where there is none."""
    return "-" if share is None else f"{100.0 * share:.0f} %"


def duration(seconds: float) -> str:
    """Return a time in words."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min"


def force_text(force_n: list[float]) -> str:
    """Return a force, (3,) or empty, as numbers."""
    if not force_n:
        return "-"
    parts = ", ".join(f"{component:.2f}" for component in force_n)
    return f"({parts}), {np.linalg.norm(force_n):.2f} in size"


def role_text(findings: Findings | OpticalFindings, name: str) -> str:
    """Return what follows an effect's title: whether it was added, or is an alternative."""
    if name in findings.named:
        return ", added"
    return ", cannot be distinguished from it" if name in findings.alternatives else ""
