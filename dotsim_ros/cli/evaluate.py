"""Compare simulators with measured presses: geometry and force, or cost and error.

`geometry` fits every model on 19 presses drawn by the seed and judges it on the other 9, then
leaves each indenter out in turn; it writes geometry.md and geometry.json. `runtime` lets the
implicit and the explicit gel follow a few presses at several resolutions; it writes runtime.md and
runtime.json. docs/evaluation.md says what the figures mean.

examples:
  dotsim_ros evaluate geometry --data DIR --sensor calibrated/ --out docs/results
  dotsim_ros evaluate geometry --data DIR --models ours tacto --splits held_out --out out
  dotsim_ros evaluate runtime --data DIR --presses 1_sphere_0 2_cone_3 --out docs/results
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

MODELS = ("ours", "explicit", "tacto", "taxim", "difftactile")
RUNTIME_PRESS_COUNT = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    subjects = parser.add_subparsers(dest="subject", required=True, metavar="SUBJECT")
    geometry = subjects.add_parser("geometry", help="surfaces and forces of every model")
    runtime = subjects.add_parser("runtime", help="frames a second against the error")
    for subject in (geometry, runtime):
        subject.add_argument("--data", type=Path, required=True, help="folder of a data set")
        subject.add_argument(
            "--out", type=Path, default=Path("docs/results"), help="folder of the files"
        )
        subject.add_argument("--json", type=Path, help="write the figures here as well")
        subject.add_argument("--seed", type=int, default=0, help="of the draws (0)")
        subject.add_argument(
            "--sensor",
            default="densetact2",
            help="name or file of the sensor (densetact2), or, for geometry, a folder with a file "
            "for each split, held_out.yaml and INDENTER.yaml",
        )
    geometry.add_argument(
        "--models", nargs="+", choices=MODELS, default=list(MODELS), help="which (all)"
    )
    geometry.add_argument(
        "--splits",
        choices=("held_out", "all"),
        default="all",
        help="the drawn one only, or with each indenter left out as well (all)",
    )
    geometry.add_argument("--count", type=int, default=9, help="presses held out (9)")
    geometry.add_argument(
        "--stated", default="densetact2", help="sensor as its maker states it, for the explicit gel"
    )
    geometry.add_argument(
        "--from-depth-mm", type=float, default=2.0, help="frames at least so deep are judged (2)"
    )
    runtime.add_argument(
        "--presses",
        nargs="+",
        metavar="NAME",
        help=f"which (the first {RUNTIME_PRESS_COUNT} held out, each of another indenter)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, print the page and write the files."""
    return _SUBJECTS[arguments.subject](arguments)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _write(
    arguments: argparse.Namespace,
    figures: dict[str, Any],
    origin: dict[str, str],
    page_of: Callable[[dict[str, Any]], str],
) -> int:
    from dotsim_ros.evaluation.provenance import provenance, write_json
    from dotsim_ros.evaluation.table import write_text

    figures["provenance"] = provenance() | {"data": arguments.data.name} | origin
    page = page_of(figures)
    for path in filter(None, (arguments.out / f"{arguments.subject}.json", arguments.json)):
        write_json(path, figures)
    write_text(arguments.out / f"{arguments.subject}.md", page)
    print(page)
    return 0


def _geometry(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.registry import factory_of
    from dotsim_ros.evaluation.report import (
        evaluate_geometry,
        geometry_page,
        read_measured,
        splits_of,
    )
    from dotsim_ros.measured.data_set import read_data_set

    factories = {
        name: factory_of(name, sensor=arguments.sensor, stated=arguments.stated)
        for name in arguments.models
    }
    measured = read_measured(read_data_set(arguments.data))
    splits = splits_of(
        measured,
        count=arguments.count,
        seed=arguments.seed,
        with_indenters=arguments.splits == "all",
    )
    figures = evaluate_geometry(
        measured,
        splits,
        factories,
        seed=arguments.seed,
        from_depth_m=1e-3 * arguments.from_depth_mm,
        progress=_say,
    )
    origin = {"sensor": str(arguments.sensor), "seed": str(arguments.seed)}
    return _write(arguments, figures, origin, lambda f: geometry_page(f, arguments.models))


def _runtime(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.report import read_measured, splits_of
    from dotsim_ros.evaluation.runtime import runtime_page, runtime_rows
    from dotsim_ros.geometry.specification import load_sensor
    from dotsim_ros.measured.data_set import read_data_set

    measured = read_measured(read_data_set(arguments.data))
    names = arguments.presses
    if names is None:
        drawn = splits_of(measured, seed=arguments.seed, with_indenters=False)[0].test
        first = {measured.presses[name].indenter: name for name in reversed(drawn)}
        names = sorted(first.values())[:RUNTIME_PRESS_COUNT]
    unknown = sorted(set(names) - set(measured.presses))
    if unknown:
        raise ValueError(
            f"no press {', '.join(unknown)}; the data set holds {', '.join(measured.presses)}"
        )
    rows = runtime_rows(
        load_sensor(arguments.sensor),
        [measured.presses[name] for name in names],
        measured.indenters,
        measured.skin,
        progress=_say,
    )
    origin = {"sensor": str(arguments.sensor), "seed": str(arguments.seed)}
    return _write(arguments, {"presses": names, "rows": rows}, origin, runtime_page)


_SUBJECTS = {"geometry": _geometry, "runtime": _runtime}
