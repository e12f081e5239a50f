"""`find-gap --demo`: draws a hidden effect, publishes its hash, searches for it, reveals it.

The reality is our own gel with another law than the library's, on another unit, with the errors of
model and instruments: quick to make, and easier than a measured sensor. `docs/gap_finder.md` says
how the finder does on data of other solvers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dotsim_ros.evaluation.gap.hidden.laws import LAWS
from dotsim_ros.evaluation.gap.hidden.reality import Truth, draw_truth, library_names, write_truth
from dotsim_ros.gap.findings import Findings
from dotsim_ros.worker_pool.pool import Crew

SENSOR = "sensor_a"
NULL_SHARE = 0.1
"""Share of the seeds for which nothing is hidden."""
SKIN_SPACING_M = 1.2e-3


def demo_truth(seed: int) -> Truth:
    """Return what a seed hides: an effect of the library, sometimes nothing."""
    random = np.random.default_rng([seed, 7])
    known = [name for name, law in LAWS.items() if law.library]
    return Truth(()) if random.random() < NULL_SHARE else draw_truth(random, known)


def is_right(findings: Findings, truth: Truth) -> bool:
    """Return whether the findings name what was hidden, alone or first in a set, or in it."""
    hidden = library_names(truth)
    if not hidden:
        return findings.verdict.value == "no_gap"
    if hidden == {""}:
        return findings.verdict.value == "unknown"
    if findings.verdict.value == "set":
        return bool(hidden & {*findings.named, *findings.alternatives})
    return hidden <= set(findings.named)


def run_demo(directory: Path, *, seed: int, workers: Crew) -> int:
    """Run the demonstration below a folder; return 0 where the finder was right, else 1.

    Raises:
        FileExistsError: data lie there that no demonstration made.
    """
    from dotsim_ros.effects.library import load_effects
    from dotsim_ros.evaluation.gap.hidden.unit import measure_unit
    from dotsim_ros.gap.presses.search import search_presses
    from dotsim_ros.gap.presses.search_state import GapRequest
    from dotsim_ros.gap.report.write import write_report
    from dotsim_ros.geometry.skin_mesh import dome_skin
    from dotsim_ros.progress import PrintedProgress
    from dotsim_ros.replacement import made_folder
    from dotsim_ros.specification import load_sensor

    sensor = load_sensor(SENSOR)
    truth = demo_truth(seed)
    print(f"hidden effect drawn, sha256 {truth.digest()}", flush=True)
    progress = PrintedProgress()
    with made_folder(directory, "measured") as part:
        measure_unit(
            part,
            sensor,
            dome_skin(sensor.gel.outer_radius_m, SKIN_SPACING_M),
            truth,
            seed=seed,
            progress=lambda done, total: progress("measure", done, total),
        )
    data = directory / "measured"
    request = GapRequest(
        measured=data,
        sensor=sensor,
        directory=directory / "run",
        indenters=data / "indenters",
        seed=seed,
        workers=workers,
    )
    findings, overlay = search_presses(request, progress)
    write_report(directory, findings, effects=load_effects(), overlay=overlay)
    write_truth(directory / "truth_opened.json", truth, seed=seed)
    hidden = ", ".join(f"{name} ({size:.3g} {LAWS[name].unit})" for name, size in truth.effects)
    print(f"\n{findings.sentence}")
    print(f"hidden was {hidden or 'nothing'} (sha256 {truth.digest()[:12]}...)")
    right = is_right(findings, truth)
    print("the finder was right" if right else "the finder was wrong")
    return 0 if right else 1
