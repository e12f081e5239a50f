# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Why something was refused, as one line that a user can read. Needs no ROS."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

from dotsim_ros.io.documents import value_text
from dotsim_ros.io.printable import cut

LONGEST_REASON = 400
"""Characters; a value that a user gave may be of any length."""

HOW = "parameters are given as --ros-args -p NAME:=VALUE, topics renamed by -r FROM:=TO"
EXPECTED = {
    "remap rule": "-r FROM:=TO, names of letters, digits, _ and / (__ns:=/NAME for a namespace, "
    "__node:=NAME for the node), no part of which begins with a digit",
    "parameter override rule": "-p NAME:=VALUE, the value written as in YAML",
    "params file": "a YAML file of NODE: {ros__parameters: {NAME: VALUE}}",
    "log level": "debug, info, warn, error or fatal, for a node as NAME:=LEVEL",
}
"""What a part of the command line should be, by ROS's name for it."""

_SOURCE_PLACE = re.compile(r",? at /\S+:\d+")
_UNREADABLE = re.compile(r"Couldn't parse ([a-z ]+): '(.*?)'\. Error: (.*)", re.DOTALL)


NEAR = 0.85
"""Share of equal letters from which one name may be meant by another: 0.92 of `ratehz` and
`rate_hz`, 0.8 of the different `image_topic` and `bag_topic`."""


def nearest(name: str, names: Iterable[str]) -> str:
    """Return which of several names may be meant by one that is none of them; empty: none."""
    return "".join(difflib.get_close_matches(name, names, n=1, cutoff=NEAR))


def reason_of(error: BaseException) -> str:
    """Return why ROS, or a node, refused something, as one line of limited length."""
    text = _SOURCE_PLACE.sub("", " ".join(str(error).split()))
    found = _UNREADABLE.search(text)
    if found is not None:
        what, given, words = found.groups()
        # The parser's own terms say nothing to a user.
        is_clear = not re.search("error not set|lexeme", words)
        cause = f" ({words.strip().rstrip('.,')})" if is_clear else ""
        text = f"{value_text(given)} is no {what} that can be read{cause}; expected "
        text += EXPECTED.get(what, HOW)
    elif type(error).__name__ == "UnknownROSArgsError":
        text = f"unknown after --ros-args: {text}; {HOW}"
    return cut(text or type(error).__name__, LONGEST_REASON)
