# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names and texts from outside, made fit for a terminal, a page and a figure.

A bag may be called whatever a file system takes: its name must not end a report with an error, run
over a page, or be read as markup.
"""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

MOST_OF_A_LABEL = 28
"""Characters of a label in a figure: more would leave the figure no room."""


LONGEST_COMPARED = 100
"""Characters of a name that is compared with others."""


def printable(text: str) -> str:
    r"""Return a text in which what cannot be shown stands as an escape, such as \x07.

    Lines stay lines. Escaped are control characters, those that change the direction of writing,
    and bytes of file names that are no text.
    """
    return "".join(
        c if c.isprintable() or c in "\n\t\u00a0" else c.encode("unicode_escape").decode()
        for c in text
    )


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return a question that names the nearest of some names, with a space before it; "" where
    none is near."""
    near = difflib.get_close_matches(name[:LONGEST_COMPARED].lower(), list(names), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def one_line(text: object) -> str:
    """Return a text on one line that can be shown."""
    return printable(" ".join(str(text).split()))


def cut(text: str, most: int) -> str:
    """Return a text without what is beyond `most` characters, and "..." in its place."""
    return text if len(text) <= most else f"{text[:most]}..."


def figure_label(text: object, most: int = MOST_OF_A_LABEL) -> str:
    """Return a text for a figure: on one line, not longer than `most`, its dollars no formulas."""
    shown = one_line(text)
    if len(shown) > most:
        shown = f"{shown[: most - 6]}...{shown[-3:]}"
    return shown.replace("$", r"\$")


@contextmanager
def boxes_for_missing_glyphs() -> Iterator[None]:
    """Draw a box, without a warning, for a sign that a figure's font does not have."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


@contextmanager
def placed(place: object) -> Iterator[None]:
    """Put the place before what is wrong there, where the words do not begin with it."""
    try:
        yield
    except ValueError as error:
        if str(error).startswith(str(place)):
            raise
        raise ValueError(f"{place}: {error}") from error
