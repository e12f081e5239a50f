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

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from dotsim_ros.cli._options import HERE, Meshes, Whole, WorkerOptions, say

EXAMPLE = "gap/example_report.html"
"""The report of `find-gap --demo`, below params/."""


def run(
    *,
    measured: Path | None = None,
    out: Path = Path("report"),
    sensor: str = "sensor_a",
    reference: Path | None = None,
    indenters: Meshes = None,
    effects: tuple[Path, ...] = (),
    channels: tuple[Literal["skin", "force", "image"], ...] = (),
    candidates: tuple[str, ...] = (),
    alpha: float = 0.02,
    budget: Whole | None = None,
    seed: Whole = 0,
    workers: WorkerOptions = HERE,
    discrepancy: Path | None = None,
    optical_noise: Path | None = None,
    fit_optical_noise: Path | None = None,
    next_: Whole = 0,
    ask: str | None = None,
    rounds: Whole = 6,
    json: Path | None = None,
    demo: bool = False,
    show_example: Annotated[bool, Parameter(name="--example")] = False,
) -> int:
    """Search, write the report, print the answer.

    Args:
        measured: folder of the data set.
        out: folder of the report.
        sensor: name or YAML file of the calibrated twin.
        reference: the unit's commissioning: what has changed since?
        effects: folders of your own effects: every NAME.py there is run as a program, or with
            --candidates those named alone; they are listed before.
        channels: used; without it all, image where the bags hold images and idle_*.png lie next to
            them.
        candidates: effects to look for; without it all.
        alpha: chance of a name without an effect.
        budget: solves of a trajectory after which sizes are refined no more; without it no limit.
        seed: of all draws.
        discrepancy: file of the model's own error; without it the shipped one.
        optical_noise: file of the images' noise; without it the shipped one.
        fit_optical_noise: only estimate the images' noise from data without an effect, and write it
            to this file.
        next_: trajectories to record next where the answer is not sure, those that decide most in
            a second of the robot's time: written to OUT/next.
        ask: command that records these, --next or one at a time, until the answer is sure. It is
            called with OUT/next and a folder, where it leaves a bag of the name of each.
        rounds: so often at most.
        json: write the findings here as well.
        demo: search a shipped set that finite elements solved; --seed says which of three.
        show_example: search nothing: print where the finished report of --demo lies, to open in a
            browser.
    """
    given = dict(locals())
    if demo + show_example + (measured is not None) != 1:
        raise ValueError("name a data set with --measured, or ask for --demo or --example")
    if show_example:
        _check_alone(given, "--example shows a finished report", ("show_example",))
        from dotsim_ros.io.files import parameter_path

        print(parameter_path(EXAMPLE).resolve().as_uri())
        return 0
    if demo:
        taken = ("demo", "out", "seed", "workers")
        why = "--demo makes its own data and searches for every effect"
        _check_alone(given, why, taken)
        if seed < 0:
            raise ValueError(f"seed is {seed}, expected 0 or more")
        from dotsim_ros.gap.demo import run_demo

        return run_demo(out, seed=seed, workers=workers.crew())
    from dotsim_ros.gap import find
    from dotsim_ros.gap.findings import as_record
    from dotsim_ros.io.files import write_json
    from dotsim_ros.io.page import HTML
    from dotsim_ros.io.printable import one_line
    from dotsim_ros.io.progress import PrintedProgress

    assert measured is not None
    common: dict[str, Any] = {
        "sensor": sensor,
        "reference": reference,
        "indenters": indenters,
        "effects": effects,
        "workers": workers.crew(),
        "progress": PrintedProgress(),
    }
    if fit_optical_noise is not None:
        null = find.fit_optical_noise(measured, fit_optical_noise, run_folder=out / "run", **common)
        print(f"{fit_optical_noise}: {null.source}")
        return 0
    common |= {
        "channels": channels or None,
        "candidates": candidates,
        "alpha": alpha,
        "budget": budget,
        "seed": seed,
        "discrepancy": discrepancy,
        "optical_noise": optical_noise,
    }
    if ask is None:
        findings = find.find_gap(measured, out=out, next_presses=next_, **common)
    else:
        from dotsim_ros.gap.ask import search_and_ask

        findings = search_and_ask(
            measured, ask, out=out, next_presses=next_ or 1, rounds=rounds, announce=say, **common
        )
    if json is not None:
        write_json(json, as_record(findings))
    print(f"\n{one_line(findings.sentence)}")
    for text in findings.warnings:
        print(f"- {one_line(text)}")
    if findings.questions:
        print(f"{out / 'next'}: {len(findings.questions)} to record")
    print(f"{out / HTML}: {findings.verdict.value}")
    return findings.verdict.exit_status


def _check_alone(given: Mapping[str, Any], why: str, taken: tuple[str, ...]) -> None:
    """Refuse options that are set and not taken."""
    others = [
        f"--{name.strip('_').replace('_', '-')}"
        for name, parameter in inspect.signature(run).parameters.items()
        if name not in taken and given[name] != parameter.default
    ]
    if others:
        raise ValueError(f"{why}: leave out {', '.join(others)}")
