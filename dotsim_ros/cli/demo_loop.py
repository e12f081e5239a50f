"""Let a policy follow a path by touch, record it, and show what it did.

Starts tactile_sim, tactile_policy, xarm_sim and tactile_record as processes of their own, which
talk over DDS, and enables the policy for a while. Leaves the bag OUT/loop, the image of the path
OUT/path.png, and the report OUT/report.html and OUT/report.md with the figures of the bag.
Needs ROS 2. DDS stays on this machine unless the environment names a Fast DDS profile.

example:
  dotsim_ros demo-loop --out out/demo-loop
  dotsim_ros demo-loop --policy out/policy --path line --seconds 30 --out out/line
"""

from __future__ import annotations

import argparse
from pathlib import Path

POLICY = "densetact2_sphere"
MOTIONS = ("line", "arc", "figure_eight", "press")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/demo-loop"), help="folder (out/demo-loop)")
    add("--policy", default=POLICY, help=f"folder or name of the policy ({POLICY})")
    add("--path", choices=MOTIONS, default="figure_eight", help="path to follow (figure_eight)")
    add("--seconds", type=float, default=20.0, help="how long the policy leads (20)")
    add("--sensor", help="name or file of the sensor (the one that the policy was trained on)")
    add("--seed", type=int, default=0, help="seed of the start (0)")
    add("--json", type=Path, help="file to write the figures to")


def run(arguments: argparse.Namespace) -> int:
    """Run the demonstration and print the paths of its files."""
    from dotsim_ros.evaluation.trajectory.loop_bag import read_loop_bag
    from dotsim_ros.evaluation.trajectory.page import path_image, trial_report
    from dotsim_ros.evaluation.trajectory.trials import judge, summary_of, trial_start
    from dotsim_ros.files import beside, write_json
    from dotsim_ros.nodes.common.transport import stay_local
    from dotsim_ros.nodes.loop.closed_loop import ClosedLoop, LoopSetup, policy_name
    from dotsim_ros.nodes.tactile_policy.files import policy_folder
    from dotsim_ros.page import write_page
    from dotsim_ros.provenance import provenance
    from dotsim_ros.replacement import note_made, remove_made
    from dotsim_ros.tasks.policy.card import read_policy
    from dotsim_ros.tasks.policy.paths import DomeContact, reference_path

    stay_local()
    folder = policy_folder(arguments.policy)
    card, _ = read_policy(folder)
    contact = DomeContact()
    path = reference_path(arguments.path, contact)
    bag: Path = arguments.out / "loop"
    remove_made(arguments.out, "loop")  # that of the demonstration before
    setup = LoopSetup(policy_name(folder), sensor=arguments.sensor or card.sensor)
    with ClosedLoop(setup, contact=contact) as loop:
        loop.start(path.name)
        start_m = trial_start(path, contact, seed=arguments.seed, number=0)
        observed = loop.trial(start_m, arguments.seconds, bag=bag)
        statuses = loop.close()
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    if failed:
        raise OSError("; ".join(failed))
    note_made(arguments.out, "loop")
    recording = read_loop_bag(bag, notes=observed.notes)
    row = judge(recording, path, setup.limits())
    image = path_image(path.name, [recording], name="path")
    page = trial_report(
        row,
        setup.limits(),
        image,
        path=path.name,
        policy=card.name,
        sensor=beside(setup.sensor, "", replaces=(".yaml", ".yml")).name,
        origin=provenance(),
    )
    write_page(arguments.out, page)
    if arguments.json is not None:
        write_json(arguments.json, row | {"provenance": provenance()})
    print(summary_of(row))
    for name in ("loop", "path.png", "report.html", "report.md"):
        print(arguments.out / name)
    return 0
