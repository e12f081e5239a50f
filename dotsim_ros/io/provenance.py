# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where an answer comes from: commit, machine, date and command, or a hash of the source."""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
import subprocess
import sys
from functools import cache
from pathlib import Path

import dotsim_ros

_PACKAGE = Path(__file__).parents[1]
_DECIDING = ("dotsim_ros", "msg_adapters", "params", "studies")


def provenance() -> dict[str, str]:
    """Return what is needed to measure again what is measured now."""
    return {
        "commit": commit_of(Path(dotsim_ros.__file__).resolve().parent.parent),
        "version": dotsim_ros.__version__,
        "machine": f"{_processor()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "command": _command(),
    }


def _command() -> str:
    """Return the command without the folder that this machine keeps its executables in."""
    program = Path(sys.argv[0])
    if program.name == "__main__.py":
        return " ".join(["python -m", program.parent.name, *sys.argv[1:]])
    # A virtual environment may be reached by a link.
    is_installed = program.parent.resolve() == Path(sys.executable).parent.resolve()
    called = [program.name] if is_installed else ["python", sys.argv[0]]
    return " ".join([*called, *sys.argv[1:]])


def commit_of(checkout: Path) -> str:
    """Return the commit that a checkout stands on, 12 digits.

    `-dirty` follows where a figure may depend on what no commit holds: a tracked file that has been
    changed, or a new one next to the code and its parameters. Documentation does not count: one run
    after the other may write its figures there.
    """

    def ask(*arguments: str) -> str:
        command = ["git", "-C", str(checkout), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        # An installed copy may lie in a folder that the checkout ignores.
        ask("ls-files", "--error-unmatch", "dotsim_ros/__init__.py")
        commit = ask("rev-parse", "--short=12", "HEAD")
        apart = (":(exclude)docs", ":(exclude)*.md")
        changed = ask("status", "--porcelain", "--untracked-files=no", "--", ".", *apart)
        added = ask("ls-files", "--others", "--exclude-standard", "--", *_DECIDING)
    except (OSError, subprocess.CalledProcessError):
        return "unknown: not run from a checkout"
    return commit + ("-dirty" if changed or added else "")


@cache
def source_hash(*source: str) -> str:
    """Return a hash of the bytes of Python files of this package, and of their names.

    Args:
        source: files, and folders with all below them, relative to the package.

    Raises:
        FileNotFoundError: there is no such file, or no Python file in the folder.
    """
    digest = hashlib.sha256()
    for part in source:
        path = _PACKAGE / part
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        if not files:
            raise FileNotFoundError(f"{path} has no Python files; install the package with them")
        for file in files:
            content = hashlib.sha256(file.read_bytes()).hexdigest()
            digest.update(f"{file.relative_to(_PACKAGE)} {content};".encode())
    return digest.hexdigest()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
