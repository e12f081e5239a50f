# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measure how far a sensor's twin is from your recordings: skin, force and image.

The sensor follows the recorded poses of every trajectory of a data set. Writes into OUT report.html
and report.md, with the errors by indenter and by trajectory and the worst image, and errors.json.
A channel that was not recorded is left out. Judge a sensor on trajectories that it was not fitted
to; docs/calibration.md says how.

example:
  dotsim_ros evaluate --data measured/mine --sensor mine.yaml --out out/evaluation
  dotsim_ros evaluate --data DIR --sensor sensor_a --trajectories 1_sphere_0 2_cone_0
"""

from __future__ import annotations

from pathlib import Path

from dotsim_ros.cli._options import HERE, Meshes, Whole, WorkerOptions, show_stage, topics_of

FROM_DEPTH_MM = 2.0


def run(
    *,
    data: Path,
    sensor: str,
    out: Path = Path("out/evaluation"),
    trajectories: tuple[str, ...] = (),
    from_depth_mm: float = FROM_DEPTH_MM,
    indenters: Meshes = None,
    workers: WorkerOptions = HERE,
    seed: Whole = 0,
    json: Path | None = None,
    pose_topic: str | None = None,
    wrench_topic: str | None = None,
    skin_topic: str | None = None,
    image_topic: str | None = None,
) -> int:
    """Judge, write the files, and print the errors.

    Args:
        data: folder of the data set.
        sensor: its name, or its file.
        out: folder to write.
        trajectories: judge these alone; without it all.
        from_depth_mm: judge frames whose tip is at least so deep.
        seed: of the noise of the simulated images.
        json: copy the errors to this file as well.
        pose_topic: of the pose.
        wrench_topic: of the wrench.
        skin_topic: of the skin.
        image_topic: of the image.
    """
    from dotsim_ros.calibration.evaluation import (
        errors_of,
        evaluate_twin,
        page_of,
        table_of,
        write_evaluation,
    )
    from dotsim_ros.io.files import write_json
    from dotsim_ros.io.page import HTML, block_markdown
    from dotsim_ros.io.printable import one_line

    found = evaluate_twin(
        data,
        sensor=sensor,
        trajectories=trajectories or None,
        indenters=indenters,
        from_depth_m=1e-3 * from_depth_mm,
        workers=workers.crew(),
        seed=seed,
        topics=topics_of(pose=pose_topic, wrench=wrench_topic, skin=skin_topic, image=image_topic),
        progress=show_stage,
    )
    errors = errors_of(found)
    page = page_of(found, errors)
    write_evaluation(out, page, errors)
    if json is not None:
        write_json(json, errors)
    print(block_markdown(table_of({"all": errors["all"], **errors["indenters"]})))
    left_out = [f"left out: {one_line(omission.reason)}" for omission in found.omissions]
    print("\n".join([*left_out, one_line(page.lead), f"report: {out / HTML}"]))
    return 0
