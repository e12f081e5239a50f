# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The ROS executables of the package: each answers `--help`, or imports its node and runs it.

Nothing heavy is imported here: a node takes seconds to import, in which a SIGINT must end the
process as quietly as it does later.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import signal
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

HELP = ("-h", "--help")


def closed_loop() -> int:
    """Run `xarm_sim`, `tactile_sim` and `tactile_policy` in one process."""
    return _run("closed_loop", executable="dotsim_closed_loop")


def closed_loop_by_old_name() -> int:
    """Run the same by the name that it had in 0.1."""
    print("closed_loop is called dotsim_closed_loop now; this name will go", file=sys.stderr)
    return closed_loop()


def indenter_player() -> int:
    """Run the player of presses."""
    return _run("indenter_player")


def tactile_policy() -> int:
    """Run the policy."""
    return _run("tactile_policy")


def tactile_record() -> int:
    """Run the recorder."""
    return _run("tactile_record")


def tactile_sim() -> int:
    """Run the simulated sensor."""
    return _run("tactile_sim")


def time_stepper() -> int:
    """Run the stepper of simulated time."""
    return _run("time_stepper")


def xarm_adapter() -> int:
    """Run the adapter to the driver of a real xArm."""
    return _run("xarm_adapter")


def xarm_sim() -> int:
    """Run the simulated arm."""
    return _run("xarm_sim")


def _run(name: str, executable: str = "") -> int:
    signal.signal(signal.SIGINT, _end)
    module = importlib.import_module(f"dotsim_ros.nodes.{name}.node")
    if any(argument in HELP for argument in sys.argv[1:]):
        print(_usage(executable or name, module))
        return 0
    status: int = module.main()
    return status


def _end(_number: int, _frame: object) -> None:
    # An exception within an import could be taken for a failure of what is imported.
    os._exit(0)


def _usage(name: str, module: ModuleType) -> str:
    options = [
        f"  {name} ({default!r}): {described}" for name, default, described in _options(module)
    ]
    lines = [
        f"usage: {name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]",
        "",
        (module.__doc__ or "").strip(),
        "",
        *(["parameters (default):", *options, ""] if options else []),
        "The parameters of a running node: ros2 param list, describe, get, set. Documentation:",
        "docs/run.md.",
    ]
    return "\n".join(lines)


def _options(module: ModuleType) -> Iterator[tuple[str, Any, str]]:
    """Yield name, default and meaning of the parameters of a node's module."""
    from dotsim_ros.nodes.common.parameters import known_parameters

    for kind in vars(module).values():
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            for name, (default, known) in known_parameters(kind).items():
                yield name, default, known.help
