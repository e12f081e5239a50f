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

from pathlib import Path
from typing import TYPE_CHECKING

from dotsim_ros.cli._options import Whole, say

if TYPE_CHECKING:
    from dotsim_ros.control.policy.training import PolicyProgress


def run(
    *,
    data: tuple[Path, ...],
    out: Path = Path("out/policy"),
    record: Path | None = None,
    name: str | None = None,
    start: Path | None = None,
    examples: Whole = 80_000,
    learning_rate: float = 2e-3,
    size: Whole = 80,
    seed: Whole = 0,
    json: Path | None = None,
) -> int:
    """Train, write the files, and print the figures.

    Args:
        data: folders of demonstrations.
        out: folder of the policy.
        record: folder of state and report; without it OUT_training.
        name: of the policy; without it that of OUT.
        start: begin with the weights of this training.pt.
        examples: shown in all.
        learning_rate: the highest one.
        size: side of the network's images, in pixels.
        seed: of the training.
        json: copy the report to this file as well.
    """
    from dotsim_ros.io.extras import extra_needed

    with extra_needed("training", "learning"):
        from dotsim_ros.control.policy.training import PolicyRecipe, train_policy
    from dotsim_ros.io.files import write_json

    report = train_policy(
        data,
        out,
        record=record or out.with_name(f"{out.name}_training"),
        name=name or out.name,
        recipe=PolicyRecipe(
            example_count=examples,
            learning_rate=learning_rate,
            side_px=size,
        ),
        seed=seed,
        progress=_show,
        start=start,
    )
    if json is not None:
        write_json(json, report)
    print("on the episodes held out:")
    for name, value in report["card"]["metrics"].items():
        print(f"{name:<36}{1e3 * value:7.3f} e-3")
    print(f"the policy is in {out}")
    return 0


def _show(progress: PolicyProgress) -> None:
    say(
        f"{progress.done}/{progress.count} examples  velocity {1e3 * progress.error_m_s:.2f} mm/s, "
        f"place {1e3 * progress.place_error_m:.2f} mm wrong  {progress.left_s / 60.0:.1f} min left"
    )
