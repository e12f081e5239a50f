# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Changes of the gel's material that several effects share."""

from __future__ import annotations

from dataclasses import replace

from dotsim_ros.effects.effect import GelTerm


def with_relaxation(term: GelTerm, share: float, time_s: float) -> GelTerm:
    """Return a gel that relaxes in one way more.

    Args:
        term: the gel.
        share: of the stress that nothing else relaxes, so that the whole stays below 1.
        time_s: of the relaxation.
    """
    if share == 0.0:
        return term
    left = 1.0 - sum(term.prony_shares)
    return replace(
        term,
        prony_shares=(*term.prony_shares, share * left),
        prony_times_s=(*term.prony_times_s, time_s),
    )
