# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was hidden in a set, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def hidden_text(effects: Sequence[Mapping[str, Any]], decoys: Sequence[str]) -> str:
    """Return what was hidden in a set, as text."""
    if not effects:
        return "nothing; decoys: " + ", ".join(decoys)
    return ", ".join(f"{e['name']} {e['size']:.3g} {e['unit']}" for e in effects)
