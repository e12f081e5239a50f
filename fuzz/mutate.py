# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Ways to spoil bytes, texts and trees of values."""

from __future__ import annotations

import copy
import struct
from random import Random
from typing import Any

HOSTILE: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    1,
    2**31,
    2**63,
    10**30,
    1e308,
    -1e308,
    1e-308,
    float("inf"),
    float("-inf"),
    float("nan"),
    640.9,
    15.75,
    "",
    "640",
    "x" * 5000,
    "../../x",
    "$x_{^\\",
    "a\nb",
    "\x1b[31m",
    "ü" * 100,
    "/dev/zero",
    "/proc/self/mem",
    [],
    {},
    [[]],
    [float("nan")] * 3,
    [0.0, 0.0, 0.0, 0.0],
    [1] * 3000,
    {"a": {}},
)
WORDS = ("&a [*a]", "*a", "!!binary x", "!!python/none", "? [1]", "{" * 80, "[" * 80, "<<: *b", "|")
LENGTHS = (0, 1, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**62, 2**64 - 1)


def spoilt_bytes(content: bytes, random: Random) -> bytes:
    """Return bytes with one to four changes."""
    spoilt = bytearray(content)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        place = random.randrange(len(spoilt) + 1)
        kind = random.randrange(7)
        if kind == 0 and place < len(spoilt):
            spoilt[place] ^= 1 << random.randrange(8)
        elif kind == 1 and place < len(spoilt):
            spoilt[place] = random.randrange(256)
        elif kind == 2:
            del spoilt[place:]
        elif kind == 3:
            del spoilt[place : place + random.choice((1, 4, 100, 5000))]
        elif kind == 4:
            spoilt[place:place] = random.randbytes(random.choice((1, 4, 100)))
        elif kind == 5:
            form = random.choice(("<I", "<Q", ">I", "<H"))
            size = struct.calcsize(form)
            spoilt[place : place + size] = struct.pack(
                form, random.choice(LENGTHS) & (2 ** (8 * size) - 1)
            )
        else:
            end = min(len(spoilt), place + random.choice((1, 16, 400)))
            spoilt[end:end] = spoilt[place:end]
    return bytes(spoilt)


def flipped_bit(content: bytes, random: Random) -> bytes:
    """Return bytes of which one bit is another."""
    spoilt = bytearray(content)
    spoilt[random.randrange(len(spoilt))] ^= 1 << random.randrange(8)
    return bytes(spoilt)


def spoilt_text(text: str, random: Random) -> str:
    """Return the text of a YAML or JSON file with one to three changes of its lines."""
    lines = text.splitlines() or [""]
    for _ in range(random.choice((1, 1, 2, 3))):
        place = random.randrange(len(lines))
        kind = random.randrange(6)
        if kind == 0:
            del lines[place]
        elif kind == 1:
            lines.insert(random.randrange(len(lines) + 1), lines[place])
        elif kind == 2:
            name, colon, _ = lines[place].partition(":")
            value = random.choice((*WORDS, *map(str, HOSTILE)))
            lines[place] = f"{name}{colon or ':'} {value}"
        elif kind == 3:
            lines[place] = " " * random.randrange(9) + lines[place].lstrip()
        elif kind == 4:
            lines[place] = lines[place].replace(":", random.choice(("", "::", ": :", ":")), 1)
        else:
            column = random.randrange(len(lines[place]) + 1)
            lines[place] = lines[place][:column] + random.choice("[]{}&*!|>'\"%@`\t\x00é")
        lines = lines or [""]
    return "\n".join(lines)


def spoilt_tree(tree: Any, random: Random) -> Any:
    """Return nested mappings and lists of which one to three leaves, names or branches differ."""
    spoilt = copy.deepcopy(tree)
    for _ in range(random.choice((1, 1, 2, 3))):
        holder, key = _place(spoilt, random)
        if holder is None:
            return random.choice(HOSTILE)
        kind = random.randrange(6)
        if kind <= 2:
            holder[key] = copy.deepcopy(random.choice(HOSTILE))
        elif kind == 3 and isinstance(holder[key], int | float):
            holder[key] = holder[key] * random.choice((-1, 1000, 0.001, 1e9, 0))
        elif kind == 4:
            del holder[key]
        elif isinstance(holder, dict):
            holder[random.choice(("", "unknown", key.upper()))] = holder[key]
        else:
            holder.append(holder[key])
    return spoilt


def _place(tree: Any, random: Random) -> tuple[Any, Any]:
    """Return a container of the tree and the key of one of its entries; None where it is none."""
    holder, key, within = None, None, tree
    while isinstance(within, dict | list) and within:
        holder = within
        key = (
            random.choice(list(within))
            if isinstance(within, dict)
            else random.randrange(len(within))
        )
        within = holder[key]
        if random.random() < 0.15:
            break
    return holder, key
