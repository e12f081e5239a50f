# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Find where simulation and measurement disagree, and name the missing effect.

Calibrates the twin within its priors, tries every effect of the library, refits the best, judges
the answer on held-out trajectories. Writes OUT/report.html, report.md, findings.json, images,
and, where an effect was named, OUT/effects_overlay.yaml, which tactile_sim loads with its parameter
`effects`. Solves are kept in OUT/run: an interrupted run resumes.

exit status: 0 no gap, 10 an effect named, 11 a set of effects that the data do not distinguish,
12 an unknown effect, 20 the data cannot be used

example:
  dotsim_ros find-gap --measured measured/after --sensor sensor_a --out report
  dotsim_ros find-gap --measured measured/after --reference measured/commissioning --out report
  dotsim_ros find-gap --example
  dotsim_ros find-gap --demo --out demo
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from dotsim_ros.cli._workers import add_worker_arguments, crew_of

EXAMPLE = "gap/example_report.html"
"""The report of `find-gap --demo`, below params/."""
CHANNELS = ("skin", "force", "image")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--measured", type=Path, help="folder of the data set")
    add("--out", type=Path, default=Path("report"), help="folder of the report (report)")
    add("--sensor", default="sensor_a", help="name or YAML file of the calibrated twin (sensor_a)")
    add("--reference", type=Path, help="the unit's commissioning: what has changed since?")
    add(
        "--indenters",
        type=Path,
        metavar="DIR",
        help="folder of the indenters' meshes (in the data set, then next to it)",
    )
    add(
        "--effects",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders of your own effects: every NAME.py there is run as a program, or with "
        "--candidates those named alone; they are listed before",
    )
    add(
        "--channels",
        nargs="+",
        choices=CHANNELS,
        help="used (all; image where the bags hold images and idle_*.png lie next to them)",
    )
    add("--candidates", nargs="+", default=[], help="effects to look for (all)")
    add("--alpha", type=float, default=0.02, help="chance of a name without an effect (0.02)")
    add(
        "--budget",
        type=int,
        help="solves of a trajectory after which sizes are refined no more (no limit)",
    )
    add("--seed", type=int, default=0, help="of all draws (0)")
    add_worker_arguments(parser)
    add("--discrepancy", type=Path, help="file of the model's own error (the shipped one)")
    add("--optical-noise", type=Path, help="file of the images' noise (the shipped one)")
    add(
        "--fit-optical-noise",
        type=Path,
        metavar="FILE",
        help="only estimate the images' noise from data without an effect, and write it here",
    )
    add("--json", type=Path, help="write the findings here as well")
    add(
        "--demo",
        action="store_true",
        help="search a shipped set that finite elements solved; --seed says which of three",
    )
    add(
        "--example",
        action="store_true",
        help="search nothing: print where the finished report of --demo lies, to open in a browser",
    )


def run(arguments: argparse.Namespace) -> int:
    """Search, write the report, print the answer."""
    asked = (arguments.demo, arguments.example, arguments.measured is not None)
    if sum(asked) != 1:
        raise ValueError("name a data set with --measured, or ask for --demo or --example")
    if arguments.example:
        _check_alone(arguments, "--example shows a finished report", ("example",))
        from dotsim_ros.io.files import parameter_path

        print(parameter_path(EXAMPLE).resolve().as_uri())
        return 0
    if arguments.demo:
        _check_demo(arguments)
        from dotsim_ros.gap.demo import run_demo

        return run_demo(arguments.out, seed=arguments.seed, workers=crew_of(arguments))
    from dotsim_ros.gap.find import find_gap, fit_optical_noise
    from dotsim_ros.gap.findings import as_record
    from dotsim_ros.io.files import write_json
    from dotsim_ros.io.page import HTML
    from dotsim_ros.io.printable import one_line
    from dotsim_ros.io.progress import PrintedProgress

    common: dict[str, Any] = {
        "sensor": arguments.sensor,
        "reference": arguments.reference,
        "indenters": arguments.indenters,
        "effects": arguments.effects,
        "workers": crew_of(arguments),
        "progress": PrintedProgress(),
    }
    if arguments.fit_optical_noise is not None:
        null = fit_optical_noise(
            arguments.measured,
            arguments.fit_optical_noise,
            run_folder=arguments.out / "run",
            **common,
        )
        print(f"{arguments.fit_optical_noise}: {null.source}")
        return 0
    findings = find_gap(
        arguments.measured,
        out=arguments.out,
        channels=arguments.channels,
        candidates=arguments.candidates,
        alpha=arguments.alpha,
        budget=arguments.budget,
        seed=arguments.seed,
        discrepancy=arguments.discrepancy,
        optical_noise=arguments.optical_noise,
        **common,
    )
    if arguments.json is not None:
        write_json(arguments.json, as_record(findings))
    print(f"\n{one_line(findings.sentence)}")
    for text in findings.warnings:
        print(f"- {one_line(text)}")
    print(f"{arguments.out / HTML}: {findings.verdict.value}")
    return findings.verdict.exit_status


def _check_demo(arguments: argparse.Namespace) -> None:
    """Refuse what the demonstration would leave out of account."""
    _check_alone(
        arguments,
        "--demo makes its own data and searches for every effect",
        ("demo", "out", "seed", "workers", "ray_address"),
    )
    if arguments.seed < 0 or arguments.workers < 1:
        raise ValueError(
            f"seed is {arguments.seed} and workers {arguments.workers}, expected 0 or more and 1 "
            "or more"
        )


def _check_alone(arguments: argparse.Namespace, why: str, taken: tuple[str, ...]) -> None:
    """Refuse options that are set and not taken."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    others = [
        f"--{name.replace('_', '-')}"
        for name, value in vars(arguments).items()
        if name not in taken and value != parser.get_default(name)
    ]
    if others:
        raise ValueError(f"{why}: leave out {', '.join(others)}")
