"""Types of arguments that several commands take."""

from __future__ import annotations

import argparse
import math


def positive(text: str) -> float:
    """Return a number above zero.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value
