"""Find where simulation and measurement disagree, and name the missing effect.

Calibrates the twin within its priors, tries every effect of the library, refits the best, judges
the answer on trajectories kept locked. Writes OUT/report.html, report.md, findings.json, images,
and, where an effect was named, OUT/effects_overlay.yaml, which tactile_sim loads with its parameter
`effects`. Solves are kept in OUT/run: a run that was broken off goes on.

exit status: 0 no gap, 10 an effect named, 11 a set of effects that the data do not tell apart,
12 an unknown effect, 20 the data cannot be used

example:
  dotsim_ros find-gap --measured measured/after --sensor sensor_a --out report
  dotsim_ros find-gap --measured measured/after --reference measured/commissioning --out report
  dotsim_ros find-gap --demo --seed 3 --out demo
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dotsim_ros.gap.findings import Findings
    from dotsim_ros.gap.presses.search_state import GapRequest

CHANNELS = ("skin", "force", "image")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--measured", type=Path, help="folder of the data set")
    add("--out", type=Path, default=Path("report"), help="folder of the report (report)")
    add("--sensor", default="sensor_a", help="name or YAML file of the calibrated twin (sensor_a)")
    add("--reference", type=Path, help="the unit's commissioning: what has changed since?")
    add("--indenters", type=Path, help="folder of the indenters' meshes (beside the data)")
    add("--effects", type=Path, nargs="+", default=[], help="folders of your own effects")
    add(
        "--channels",
        nargs="+",
        choices=CHANNELS,
        help="used (all; image where the bags hold images and idle_*.png lie beside them)",
    )
    add("--candidates", nargs="+", default=[], help="effects to look for (all)")
    add("--alpha", type=float, default=0.02, help="chance of a name without an effect (0.02)")
    add("--budget", type=int, help="most solves of a trajectory (no limit)")
    add("--seed", type=int, default=0, help="of all draws (0)")
    add("--workers", type=int, default=2, help="processes (2)")
    add("--discrepancy", type=Path, help="file of the model's own error (the shipped one)")
    add("--optical-noise", type=Path, help="file of the images' noise (the shipped one)")
    add(
        "--fit-optical-noise",
        type=Path,
        metavar="FILE",
        help="only learn what images show in which nothing is wrong, and write it here",
    )
    add("--json", type=Path, help="write the findings here as well")
    add("--demo", action="store_true", help="hide an effect drawn by the seed, and find it")


def run(arguments: argparse.Namespace) -> int:
    """Search, write the report, print the answer."""
    from dotsim_ros.files import write_json
    from dotsim_ros.gap.findings import Findings, Verdict, as_record
    from dotsim_ros.gap.report.write import write_findings

    if arguments.demo == (arguments.measured is not None):
        raise ValueError("name a data set with --measured, or ask for --demo")
    if arguments.demo:
        from dotsim_ros.evaluation.gap.demo import run_demo

        return run_demo(arguments.out, seed=arguments.seed, workers=arguments.workers)
    if arguments.fit_optical_noise is not None:
        fit_optical_noise(arguments)
        return 0
    try:
        findings = search(arguments)
    except ValueError as error:
        findings = Findings(Verdict.UNUSABLE, f"The data cannot be used: {error}")
        write_findings(arguments.out, findings, None, effects=arguments.effects)
    if arguments.json is not None:
        write_json(arguments.json, as_record(findings))
    print(f"\n{findings.sentence}")
    for text in findings.warnings:
        print(f"- {text}")
    print(f"{arguments.out / 'report.html'}: {findings.verdict.value}")
    return findings.verdict.exit_status


def search(arguments: argparse.Namespace) -> Findings:
    """Return the findings of a search, its report written."""
    from dotsim_ros.gap.find import find_gap_with_images
    from dotsim_ros.gap.report.write import write_findings
    from dotsim_ros.progress import PrintedProgress

    request = request_of(arguments)
    findings, overlay = find_gap_with_images(request, PrintedProgress())
    write_findings(arguments.out, findings, overlay, effects=arguments.effects)
    return findings


def fit_optical_noise(arguments: argparse.Namespace) -> None:
    """Learn what the images of a data set show in which nothing is wrong; write it."""
    from dotsim_ros.gap.find import fit_noise_of_images
    from dotsim_ros.gap.images.null import save_optical_null
    from dotsim_ros.progress import PrintedProgress

    null = fit_noise_of_images(request_of(arguments), PrintedProgress())
    save_optical_null(null, arguments.fit_optical_noise)
    print(f"{arguments.fit_optical_noise}: {null.source}")


def request_of(arguments: argparse.Namespace) -> GapRequest:
    """Return what is searched, and how."""
    from dotsim_ros.gap.find import channels_of
    from dotsim_ros.gap.presses.search_state import GapRequest
    from dotsim_ros.specification import load_sensor

    return GapRequest(
        measured=arguments.measured,
        sensor=load_sensor(arguments.sensor),
        directory=arguments.out / "run",
        reference=arguments.reference,
        indenters=arguments.indenters,
        effects=tuple(arguments.effects),
        channels=tuple(arguments.channels or channels_of(arguments.measured)),
        candidates=tuple(arguments.candidates),
        alpha=arguments.alpha,
        budget=arguments.budget,
        seed=arguments.seed,
        workers=arguments.workers,
        discrepancy=arguments.discrepancy,
        optical_noise=arguments.optical_noise,
    )
