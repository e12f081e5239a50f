# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Train a policy that follows paths by touch, on demonstrations, by behaviour cloning.

ResNet-18 from random weights learns the expert's velocity for each path. OUT gets the weights in
half precision with their card and the graph that runs without torch; next to it, in OUT_training,
the state of the training (an interrupted run resumes from it) and training.json with the
errors on the episodes held out. One core shows about 60 examples a second.

example:
  dotsim_ros train-policy --data out/demonstrations --out out/policy
  dotsim_ros train-policy --data out/demonstrations out/more --examples 20000 \\
      --start out/policy_training/training.pt --learning-rate 5e-4 --out out/policy_2
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dotsim_ros.control.policy.training import PolicyProgress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--data", type=Path, nargs="+", required=True, metavar="DIR", help="demonstrations")
    add("--out", type=Path, default=Path("out/policy"), metavar="DIR", help="folder (out/policy)")
    add("--record", type=Path, metavar="DIR", help="folder of state and report (OUT_training)")
    add("--name", metavar="NAME", help="name of the policy (that of OUT)")
    add("--start", type=Path, metavar="FILE", help="begin with the weights of this training.pt")
    add("--examples", type=int, default=80_000, metavar="N", help="examples shown in all (80000)")
    add("--learning-rate", type=float, default=2e-3, metavar="RATE", help="the highest one (2e-3)")
    add("--size", type=int, default=80, metavar="PX", help="side of the network's images (80)")
    add("--seed", type=int, default=0, help="seed of the training (0)")
    add("--json", type=Path, metavar="FILE", help="copy the report to this file as well")


def run(arguments: argparse.Namespace) -> int:
    """Train, write the files, and print the figures."""
    try:
        from dotsim_ros.control.policy.training import PolicyRecipe, train_policy
    except ModuleNotFoundError as error:
        raise ValueError(
            f"training needs {error.name}, which is not installed; install dotsim_ros[learning]"
        ) from error
    from dotsim_ros.io.files import write_json

    report = train_policy(
        arguments.data,
        arguments.out,
        record=arguments.record or arguments.out.with_name(f"{arguments.out.name}_training"),
        name=arguments.name or arguments.out.name,
        recipe=PolicyRecipe(
            example_count=arguments.examples,
            learning_rate=arguments.learning_rate,
            side_px=arguments.size,
        ),
        seed=arguments.seed,
        progress=_show,
        start=arguments.start,
    )
    if arguments.json is not None:
        write_json(arguments.json, report)
    print("on the episodes held out:")
    for name, value in report["card"]["metrics"].items():
        print(f"{name:<36}{1e3 * value:7.3f} e-3")
    print(f"the policy is in {arguments.out}")
    return 0


def _show(progress: PolicyProgress) -> None:
    print(
        f"{progress.done}/{progress.count} examples  velocity {1e3 * progress.error_m_s:.2f} mm/s, "
        f"place {1e3 * progress.place_error_m:.2f} mm wrong  {progress.left_s / 60.0:.1f} min left",
        file=sys.stderr,
        flush=True,
    )
