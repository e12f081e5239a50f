# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Say in each source file whose it is and under which licence, as SPDX and the linters of ROS do.

    python .ci/license_headers.py
    python .ci/license_headers.py --check

The first writes the two lines where they are missing; the second names the files that lack them,
for CI, and exits with 1. Files of parameters are data, and documents say it once: LICENSE.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

LINES = ("Copyright 2026 The dotsim_ros authors", "SPDX-License-Identifier: Apache-2.0")
HASH, SLASHES, STARS, ARROWS = ("# ", ""), ("// ", ""), ("/* ", " */"), ("<!-- ", " -->")
COMMENTS = {
    ".py": HASH,
    ".js": SLASHES,
    ".css": STARS,
    ".html": ARROWS,
    ".xacro": ARROWS,
}
"""What opens and what closes a comment, by the name's ending."""
PROGRAMS = (".ci/run", "Makefile", "docker/Dockerfile")
"""With comments as in Python, and a name that does not tell."""
FIRST = ("#!", "<?xml", "<!doctype")
"""Beginnings of a line that has to stay the first."""


def header_of(name: str) -> str:
    """Return the lines that a file of a name must have."""
    opening, closing = HASH if name in PROGRAMS else COMMENTS[Path(name).suffix]
    return "".join(f"{opening}{line}{closing}\n" for line in LINES)


def with_header(text: str, header: str) -> str:
    """Return a file's text with the header at its top, which it may have already."""
    first, _, rest = text.partition("\n")
    kept, below = (f"{first}\n", rest) if first.lower().startswith(FIRST) else ("", text)
    if below.startswith(header):
        return text
    gap = "\n" if below else ""
    return f"{kept}{header}{gap}{below}"


def sources(root: Path) -> Iterator[str]:
    """Yield the names of the source files that git knows, and of new ones that it would take."""
    command = ["git", "-C", str(root), "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        is_source = name in PROGRAMS or Path(name).suffix in COMMENTS
        if is_source and (root / name).is_file():
            yield name


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the headers, or compare; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, add_help=True)
    parser.add_argument("--root", type=Path, default=Path(), help="of the checkout (here)")
    parser.add_argument("--check", action="store_true", help="write nothing; tell what lacks them")
    given = parser.parse_args(arguments)
    lacking = 0
    for name in sources(given.root):
        path = given.root / name
        text = path.read_text(encoding="utf-8")
        completed = with_header(text, header_of(name))
        if completed == text:
            continue
        lacking += 1
        if given.check:
            print(f"{name}: no licence at its top; python .ci/license_headers.py writes it")
        else:
            path.write_text(completed, encoding="utf-8")
    print(f"{lacking} files without a licence" if given.check else f"{lacking} files written")
    return 1 if given.check and lacking else 0


if __name__ == "__main__":
    sys.exit(main())
