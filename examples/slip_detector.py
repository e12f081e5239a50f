# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Train a slip detector on simulated touches.

You learn how a plan becomes a data set of touches, and how a small network learns from it whether
an object slips: from the skin's motion and the force of two frames. Every fifth touch is left out
of the training and judged; the picture shows one of them.

python examples/slip_detector.py [OUT [TOUCHES]]
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from dotsim_ros.gel.make import skin_of
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.learning.slip import SlipDetector, labelled_frames, touches_in
from dotsim_ros.learning.touches.plan import read_plan
from dotsim_ros.learning.touches.run import make_touches


def main(out: Path, count: int) -> None:
    plan = read_plan(Path(__file__).parent / "slip_touches.yaml")
    make_touches(plan, out, count=count, kind="webdataset", progress=PrintedProgress())
    touches = list(touches_in(out, skin_of(plan.sensor.gel).rest_position_m))

    left_out = touches[::5]
    learnt = [touch for number, touch in enumerate(touches) if number % 5]
    detector = SlipDetector(*labelled_frames(learnt))
    features, truth = labelled_frames(left_out)
    found = detector(features)
    print(
        f"{(truth & found).sum()} of {truth.sum()} slips found, "
        f"{(~truth & ~found).sum()} of {(~truth).sum()} frames without slip right"
    )

    shown = max(left_out, key=lambda touch: touch.slips().sum())
    features, truth = shown.features(), shown.slips()
    figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    ratio = features[:, 0]
    axes.plot(ratio, color="black", label="tangential over normal force")
    axes.plot(np.where(truth, ratio, np.nan), "s", color="tab:red", label="slips")
    axes.plot(np.where(detector(features), ratio, np.nan), "x", color="black", label="detector")
    axes.set(xlabel="frame", ylim=(0.0, None))
    axes.legend()
    figure.savefig(out / "slip.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path("out/slip"))
    parser.add_argument("touches", nargs="?", type=int, default=300)
    given = parser.parse_args()
    try:
        main(given.out, given.touches)
    except (OSError, ValueError) as error:
        parser.error(str(error))
