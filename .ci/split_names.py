# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""For mkdocstrings: read `a, b: text` in a docstring's section as an entry each for `a` and `b`."""

from __future__ import annotations

import re
from typing import Any

import griffe

ENTRY = re.compile(r"^( {4,})(\w+(?:, \w+)+): ")


def split(text: str) -> str:
    """Return a docstring with an entry for each name; the lines of an entry follow each of them."""
    done: list[str] = []
    lines = text.split("\n")
    while lines:
        line = lines.pop(0)
        entry = ENTRY.match(line)
        if entry is None:
            done.append(line)
            continue
        indent, names = entry[1], entry[2].split(", ")
        own = [line[entry.end() :]]
        while lines and lines[0].startswith(f"{indent} "):
            own.append(lines.pop(0))
        for name in names:
            done += [f"{indent}{name}: {own[0]}", *own[1:]]
    return "\n".join(done)


class SplitNames(griffe.Extension):
    """Does so for every docstring, when its object has been read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Replace the docstring of an object."""
        if obj.docstring is not None:
            obj.docstring.value = split(obj.docstring.value)
