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

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from dotsim_ros.cli._options import Judged, Whole, redraw, say
from dotsim_ros.io.progress import bar

Network = Literal["ours", "paper", "paper_direct", "paper_mobile", "paper_mobile_warped", "unet"]

if TYPE_CHECKING:
    from dotsim_ros.learning.training import TrainingProgress


def usual_hold_out(count: int) -> int:
    """Return on how many of so many trajectories a network is judged."""
    from dotsim_ros.data.split import HELD_OUT_COUNT

    return HELD_OUT_COUNT if count > 2 * HELD_OUT_COUNT else count // 3


def run(
    *,
    data: Path,
    sensor: str,
    out: Path = Path("out/optics"),
    sensor_out: Path | None = None,
    record: Path | None = None,
    network: Network = "ours",
    hold_out: Annotated[Whole | None, Parameter(group=Judged)] = None,
    leave_out: Annotated[tuple[str, ...], Parameter(group=Judged)] = (),
    trajectories: tuple[str, ...] = (),
    split_seed: Whole = 0,
    seed: Whole = 0,
    epochs: Whole | None = None,
    size: Whole | None = None,
    json: Path | None = None,
) -> int:
    """Train, write the files, and print the figures.

    Args:
        data: folder of the data set.
        sensor: the sensor's file, or its name.
        out: folder of the network.
        sensor_out: sensor's file to write; without it OUT/sensor.yaml.
        record: folder of state, preview and report; without it OUT_training.
        network: kind of the network.
        hold_out: judge on so many trajectories, drawn by --split-seed; without it on a third.
        leave_out: judge on all of these indenters.
        trajectories: use these alone; without it all with images.
        split_seed: seed of the split.
        seed: of the training.
        epochs: passes over all frames; without it the network's own number.
        size: width of the network's images, in pixels.
        json: copy the figures to this file as well.
    """
    from dotsim_ros.io.extras import extra_needed

    with extra_needed("training", "learning"):
        from dotsim_ros.learning.run import SENSOR, TrainOpticsRequest, train_optics
    from dotsim_ros.data.data_set import read_data_set
    from dotsim_ros.data.split import split_of
    from dotsim_ros.io.files import write_json
    from dotsim_ros.specification import load_sensor, read_comment, sensor_path

    sensor_file = sensor_out or out / SENSOR
    if sensor_file.suffix not in (".yaml", ".yml"):
        raise ValueError(f"--sensor-out is {sensor_file}, expected a file that ends in .yaml")
    filmed = read_data_set(data).filmed(trajectories)
    train, held_out = split_of(
        filmed,
        leave_out=leave_out,
        hold_out=usual_hold_out(len(filmed)) if hold_out is None else hold_out,
        seed=split_seed,
    )
    report = train_optics(
        TrainOpticsRequest(
            data=data,
            sensor=load_sensor(sensor),
            train=train,
            held_out=held_out,
            kind=network,
            seed=seed,
            epochs=epochs,
            size=size,
            out=out,
            record=record or out.with_name(f"{out.name}_training"),
            sensor_file=sensor_file,
            sensor_comment="\n".join(read_comment(sensor_path(sensor))),
        ),
        say=say,
        progress=_show,
    )
    if json is not None:
        write_json(json, report)
    print(f"trained on {len(train)} trajectories, judged on {len(held_out) or 'the same'}")
    for name, value in report["metrics"].items():
        print(f"{name:<28}{value:7.2f}")
    print(f"{report['epochs']} epochs in {report['minutes']} minutes of CPU time; files in {out}")
    return 0


def _show(progress: TrainingProgress) -> None:
    """Draw a bar on a terminal; elsewhere print a line an epoch."""
    note = (
        f"epoch {progress.epoch}/{progress.epochs}  {progress.psnr_db:.2f} dB in training  "
        f"{progress.left_s / 60.0:.1f} min left"
    )
    is_last = progress.epoch == progress.epochs
    redraw(bar(progress.epoch / progress.epochs, note), is_last=is_last)
