# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Train a network that completes the images of a sensor, from measured presses.

The data set is one as tactile_record writes it: dataset.yaml, bags with poses and images, idle
images, indenters; the sensor is a calibrated one. Writes into OUT the weights with their card, the
graph that runs without torch, the idle image that goes with them, and sensor.yaml to run it all;
next to it, into OUT_training, preview.png (measured, warped, predicted, errors), training.json and
the state of the training: an interrupted run resumes where it stopped. With CUDA the
networks see the measured resolution; without, the published ones are trained on smaller images.

example:
  dotsim_ros train-optics --data measured/sensor_a --sensor sensor_a --out out/optics
  dotsim_ros train-optics --data measured/sensor_a --sensor sensor_a --out out/paper \\
      --network paper --epochs 20 --size 160
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dotsim_ros.optics.network.card import TRAINED

if TYPE_CHECKING:
    from dotsim_ros.learning.training import TrainingProgress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--data", type=Path, required=True, metavar="DIR", help="folder of the data set")
    add("--sensor", required=True, metavar="FILE", help="the sensor's file, or its name")
    add("--out", type=Path, default=Path("out/optics"), metavar="DIR", help="folder (out/optics)")
    add("--sensor-out", type=Path, metavar="FILE", help="sensor's file to write (OUT/sensor.yaml)")
    add(
        "--record",
        type=Path,
        metavar="DIR",
        help="folder of state, preview and report (OUT_training)",
    )
    add("--network", choices=TRAINED, default="ours", help="kind of the network (ours)")
    judged = parser.add_mutually_exclusive_group()
    judged.add_argument(
        "--hold-out",
        type=int,
        metavar="COUNT",
        help="judge on so many trajectories, drawn by the seed of --split-seed; by default a third",
    )
    judged.add_argument(
        "--leave-out", nargs="+", metavar="INDENTER", help="judge on all of these indenters"
    )
    add("--trajectories", nargs="+", metavar="NAME", help="use these alone (all with images)")
    add("--split-seed", type=int, default=0, help="seed of the split (0)")
    add("--seed", type=int, default=0, help="seed of the training (0)")
    add(
        "--epochs",
        type=int,
        metavar="COUNT",
        help="passes over all frames (the network's own number)",
    )
    add("--size", type=int, metavar="WIDTH", help="width of the network's images, in pixels")
    add("--json", type=Path, metavar="FILE", help="copy the figures to this file as well")


def split(arguments: argparse.Namespace) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the trajectories to train on and to judge on.

    Raises:
        ValueError: an unknown trajectory or indenter, or nothing left to train on.
    """
    from dotsim_ros.data.data_set import read_data_set
    from dotsim_ros.data.split import HELD_OUT_COUNT, hold_out_of_protocols

    entries = [entry for entry in read_data_set(arguments.data).entries if entry.has_images]
    indenter_of = {entry.name: entry.indenter for entry in entries}
    names = sorted(arguments.trajectories or indenter_of)
    unknown = sorted(set(names) - set(indenter_of))
    if unknown or not names:
        raise ValueError(
            f"{arguments.data} has no trajectory with images named {', '.join(unknown) or 'at all'}"
        )
    if arguments.leave_out is not None:
        known = {indenter_of[name] for name in names}
        missing = sorted(set(arguments.leave_out) - known)
        if missing or set(arguments.leave_out) == known:
            raise ValueError(
                f"--leave-out {' '.join(arguments.leave_out)}: indenters are "
                f"{', '.join(sorted(known))}; name some of them, not all"
            )
        held_out = tuple(name for name in names if indenter_of[name] in arguments.leave_out)
        return tuple(name for name in names if name not in held_out), held_out
    count = arguments.hold_out
    if count is None:
        count = HELD_OUT_COUNT if len(names) > 2 * HELD_OUT_COUNT else len(names) // 3
    if not count:
        return tuple(names), ()
    # The same draw as calibrate's: neither gel nor camera has seen what is judged.
    return hold_out_of_protocols(names, count, arguments.split_seed)


def run(arguments: argparse.Namespace) -> int:
    """Train, write the files, and print the figures."""
    try:
        from dotsim_ros.learning.run import SENSOR, TrainOpticsRequest, train_optics
    except ModuleNotFoundError as error:
        raise ValueError(
            f"training needs {error.name}, which is not installed; install dotsim_ros[learning]"
        ) from error
    from dotsim_ros.io.files import write_json
    from dotsim_ros.specification import load_sensor, read_comment, sensor_path

    sensor_file = arguments.sensor_out or arguments.out / SENSOR
    if sensor_file.suffix not in (".yaml", ".yml"):
        raise ValueError(f"--sensor-out is {sensor_file}, expected a file that ends in .yaml")
    train, held_out = split(arguments)
    report = train_optics(
        TrainOpticsRequest(
            data=arguments.data,
            sensor=load_sensor(arguments.sensor),
            train=train,
            held_out=held_out,
            kind=arguments.network,
            seed=arguments.seed,
            epochs=arguments.epochs,
            size=arguments.size,
            out=arguments.out,
            record=arguments.record or arguments.out.with_name(f"{arguments.out.name}_training"),
            sensor_file=sensor_file,
            sensor_comment="\n".join(read_comment(sensor_path(arguments.sensor))),
        ),
        say=lambda line: print(line, file=sys.stderr, flush=True),
        progress=_show,
    )
    if arguments.json is not None:
        write_json(arguments.json, report)
    print(f"trained on {len(train)} trajectories, judged on {len(held_out) or 'the same'}")
    for name, value in report["metrics"].items():
        print(f"{name:<28}{value:7.2f}")
    print(
        f"{report['epochs']} epochs in {report['minutes']} minutes of CPU time; files in "
        f"{arguments.out}"
    )
    return 0


def _show(progress: TrainingProgress) -> None:
    """Draw a bar on a terminal; elsewhere print a line an epoch."""
    filled = 30 * progress.epoch // progress.epochs
    line = (
        f"[{'#' * filled:<30}] epoch {progress.epoch}/{progress.epochs}  "
        f"{progress.psnr_db:.2f} dB in training  {progress.left_s / 60.0:.1f} min left"
    )
    if sys.stderr.isatty():
        end = "\n" if progress.epoch == progress.epochs else ""
        print(f"\r{line}", end=end, file=sys.stderr, flush=True)
    else:
        print(line, file=sys.stderr, flush=True)
