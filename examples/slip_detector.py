# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Train a slip detector on simulated touches.

You learn how a plan becomes a data set of touches, and how a small network learns from it whether
an object slips: from the skin's motion and the force of two frames. Every fifth touch is left out
of the training and judged; the picture shows one of them.

python examples/slip_detector.py [OUT [TOUCHES]]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from dotsim_ros.gel.make import skin_of
from dotsim_ros.learning.slip import SlipDetector, touches_in
from dotsim_ros.learning.touches.plan import read_plan
from dotsim_ros.learning.touches.run import make_touches


def main(out: Path, count: int) -> None:
    plan = read_plan(Path(__file__).parent / "slip_touches.yaml")
    show = lambda what, done, of: print(f"\r{what} {done}/{of}", end="", flush=True)  # noqa: E731
    make_touches(plan, out, count=count, kind="webdataset", workers=1, progress=show)
    touches = list(touches_in(out, skin_of(plan.sensor.gel).rest_position_m))

    features = [touch.features() for touch in touches]
    slips = [touch.slips() for touch in touches]
    judged = [touch.judged() for touch in touches]

    def frames(of, numbers):
        return np.concatenate([of[number][judged[number]] for number in numbers])

    left_out = range(0, count, 5)
    learnt = [number for number in range(count) if number not in left_out]
    detector = SlipDetector(frames(features, learnt), frames(slips, learnt))
    truth, found = frames(slips, left_out), detector(frames(features, left_out))
    print(
        f"\n{(truth & found).sum()} of {truth.sum()} slips found, "
        f"{(~truth & ~found).sum()} of {(~truth).sum()} frames without slip right"
    )

    shown = max(left_out, key=lambda number: slips[number].sum())
    figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    ratio = features[shown][:, 0]
    axes.plot(ratio, color="black", label="tangential over normal force")
    axes.plot(np.where(slips[shown], ratio, np.nan), "s", color="tab:red", label="slips")
    axes.plot(np.where(detector(features[shown]), ratio, np.nan), "x", label="detector")
    axes.set(xlabel="frame", ylim=(0.0, None))
    axes.legend()
    figure.savefig(out / "slip.png")


if __name__ == "__main__":
    main(
        Path(sys.argv[1] if len(sys.argv) > 1 else "out/slip"),
        int(sys.argv[2]) if len(sys.argv) > 2 else 300,
    )
