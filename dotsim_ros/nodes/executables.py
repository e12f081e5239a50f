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
from functools import partial
from importlib.util import find_spec
from types import ModuleType
from typing import Any

HELP = ("-h", "--help")
NEEDS_ROS = (
    "needs ROS 2, which is not there: source /opt/ros/jazzy/setup.bash, "
    "or pip install 'dotsim_ros[ros]'"
)


def _run(name: str, executable: str = "") -> int:
    signal.signal(signal.SIGINT, _end)
    try:
        module = importlib.import_module(f"dotsim_ros.nodes.{name}.node")
    except ModuleNotFoundError:
        if find_spec("rclpy") is not None:
            raise
        print(f"{executable or name} {NEEDS_ROS}", file=sys.stderr)
        return 2
    if any(argument in HELP for argument in sys.argv[1:]):
        print(_usage(executable or name, module))
        return 0
    status: int = module.main()
    return status


indenter_player = partial(_run, "indenter_player")
tactile_policy = partial(_run, "tactile_policy")
tactile_record = partial(_run, "tactile_record")
tactile_sim = partial(_run, "tactile_sim")
time_stepper = partial(_run, "time_stepper")
xarm_adapter = partial(_run, "xarm_adapter")
xarm_sim = partial(_run, "xarm_sim")
closed_loop = partial(_run, "closed_loop", executable="dotsim_closed_loop")


def closed_loop_by_old_name() -> int:
    """Run the closed loop by the name that it had in 0.1."""
    print("closed_loop is called dotsim_closed_loop now; this name will go", file=sys.stderr)
    return closed_loop()


def _end(_number: int, _frame: object) -> None:
    # An exception within an import could be taken for a failure of what is imported.
    os._exit(0)


def _usage(name: str, module: ModuleType) -> str:
    options = [
        f"  {name} ({default!r}): {known.help}"
        for name, (default, known) in _parameters(module).items()
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


def _parameters(module: ModuleType) -> dict[str, Any]:
    """Return default and description of the parameters of a node's module, by name."""
    from dotsim_ros.nodes.common.parameters import known_parameters

    found = {}
    for kind in vars(module).values():
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            found.update(known_parameters(kind))
    return found
