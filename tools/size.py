# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Print how large the project is: Python lines that are installed, others, tests, and words.

python tools/size.py
"""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
INSTALLED = ("dotsim_ros", "msg_adapters")
READ_AS_TABLES = ("docs/api/", "docs/results/")
"""Pages that are generated and looked up, not read."""


def lines(paths: list[str]) -> int:
    """Return the lines of files."""
    return sum(len((ROOT / path).read_bytes().splitlines()) for path in paths)


def words(paths: list[str]) -> int:
    """Return the words of files."""
    return sum(len((ROOT / path).read_text(encoding="utf-8").split()) for path in paths)


def main() -> None:
    """Print the table."""
    listed = subprocess.run(["git", "-C", ROOT, "ls-files"], capture_output=True, text=True)
    files = [path for path in listed.stdout.splitlines() if (ROOT / path).is_file()]
    python = [path for path in files if path.endswith(".py")]
    installed = [path for path in python if path.split("/")[0] in INSTALLED]
    tests = [path for path in python if path.startswith("test/")]
    others = sorted(set(python) - set(installed) - set(tests))
    pages = [path for path in files if path.startswith("docs/") and path.endswith(".md")]
    read = [path for path in pages if not path.startswith(READ_AS_TABLES)]
    print(f"Python lines installed      {lines(installed):7,}")
    for folder in sorted({"/".join(path.split("/")[:2]) for path in installed}):
        inside = [path for path in installed if f"{path}/".startswith(f"{folder}/")]
        print(f"  {folder:26}{lines(inside):7,}")
    print(f"other Python but tests      {lines(others):7,}")
    print(f"tests                       {lines(tests):7,}")
    print(f"words in docs               {words(read):7,}")
    print(f"words in generated pages    {words(sorted(set(pages) - set(read))):7,}")
    print(f"words in the README         {words(['README.md']):7,}")


if __name__ == "__main__":
    main()
