"""Where a figure comes from: the commit, the machine, the date and the command."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
import sys
from pathlib import Path

import dotsim_ros


def provenance() -> dict[str, str]:
    """Return what is needed to measure again what is measured now."""
    return {
        "commit": _commit(),
        "version": dotsim_ros.__version__,
        "machine": f"{_processor()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "command": _command(),
    }


def _command() -> str:
    """Return the command without the folder that this machine keeps its executables in."""
    program = Path(sys.argv[0])
    is_installed = program.parent == Path(sys.executable).parent
    called = [program.name] if is_installed else ["python", sys.argv[0]]
    return " ".join([*called, *sys.argv[1:]])


def _commit() -> str:
    checkout = Path(dotsim_ros.__file__).parent.parent
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown: not run from a checkout"
    return done.stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
