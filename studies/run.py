# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs studies: a name, a function, and what its record is made with.

    python -m studies                      list the studies, with the minutes that each takes
    python -m studies NAME --help          the options of one
    python -m studies NAME [OPTION ...]    run one
    python -m studies NAME NAME ...        run several with the options of their records
    python -m studies all                  make all records of a release

`--json DIR` writes each record to DIR/NAME.json. A record below docs/results is made from a clean
commit, and only if it does not name that commit yet, so that an interrupted run is resumed. Sealed
records, of data that can be judged once only, are not made again. Measured and real data are read
from $DOTSIM_ROS_DATA (../shared).
"""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cyclopts import App, Parameter

from dotsim_ros.io.extras import extra_needed
from dotsim_ros.io.files import write_json
from dotsim_ros.io.provenance import commit_of, provenance
from studies.data import DATA
from studies.results_page import RESULTS, origin_of, tables_of

ROOT = Path(__file__).resolve().parents[1]
HELP = {"--help", "-h"}
FAILED = "failed"
"""Key of the figures under which a study lists what failed."""


def expect_known(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Check that names are known ones, and that there is one.

    Raises:
        ValueError: they are not; says which ones there are.
    """
    names, choices = list(given), list(known)
    if unknown := [name for name in names if name not in choices] or ([] if names else ["named"]):
        raise ValueError(f"no {what} {', '.join(unknown)}; choose from {', '.join(choices)}")


def expect_positive(**given: float) -> None:
    """Check that numbers are above zero.

    Raises:
        ValueError: one is not; names it.
    """
    for name, value in given.items():
        if not value > 0:
            raise ValueError(f"{name} is {value:g}, expected more than 0")


@dataclass(frozen=True)
class Study:
    """A study, and how its record is made.

    Attributes:
        minutes: that it takes, roughly, on two slow cores.
        function: `module:function` below `studies`; it returns figures.
        options: of the function, for the record, where its defaults are others.
        before: commands that make what the record needs, below out/; not run for options.
        command: makes the record in place of a function, as it is given with `--json FILE`.
        in_all: whether `all` runs it: not what only makes data, or parts of another record.
    """

    minutes: int
    function: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    before: tuple[str, ...] = ()
    command: str = ""
    in_all: bool = True

    def summary(self) -> str:
        """Return the first line of the function's docstring, without importing it."""
        if self.command:
            return self.command.partition(" --")[0]
        module, _, name = self.function.partition(":")
        source = (ROOT / "studies" / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
        for node in ast.parse(source).body:
            if isinstance(node, ast.FunctionDef) and node.name == name:
                return (ast.get_docstring(node) or "").partition("\n")[0]
        raise ValueError(f"there is no {self.function}")

    def load(self) -> Callable[..., dict[str, Any]]:
        """Return the function."""
        module, _, name = self.function.partition(":")
        found: Callable[..., dict[str, Any]] = getattr(
            importlib.import_module(f"studies.{module}"), name
        )
        return found


SENSOR_A = f"--data {DATA}/measured/sensor_a"
KNOWN_NOISE = "--noise-skin-discretisation-m 0.3e-3 --joint-steps 0"
FIRST = f"dotsim_ros calibrate {SENSOR_A} --workers 1 --run out/run_first --out out/first.yaml"
APART = (
    f"dotsim_ros calibrate-camera {SENSOR_A} --sensor densetact2 --leave-out 1_sphere "
    "3_lying_cylinder --out out/apart/apart.yaml"
)
STUDIES: dict[str, Study] = {
    "accuracy": Study(30, "geometry.accuracy:accuracy"),
    "batch": Study(5, "speed.batch:batch"),
    "calibration_sensor_a": Study(
        15,
        command=f"dotsim_ros calibrate {SENSOR_A} --workers 1 --run out/run_first --out "
        "out/again.yaml",
    ),
    "calibration_sensor_a_28": Study(
        20,
        before=(FIRST,),
        command=f"dotsim_ros calibrate {SENSOR_A} --sensor out/first.yaml --fit E nu friction c20 "
        f"{KNOWN_NOISE} --solves 5 --hold-out 0 --workers 1 --run out/run_28 "
        "--out docs/results/sensor_a_28.yaml",
    ),
    "calibration_sensor_a_stiffening": Study(
        15,
        before=(FIRST,),
        command=f"dotsim_ros calibrate {SENSOR_A} --sensor out/first.yaml --fit E nu friction c20 "
        f"{KNOWN_NOISE} --solves 5 --workers 1 --run out/run_19 --out out/sensor_a.yaml",
    ),
    "calibration_sensor_a_thickness": Study(
        15,
        command=f"dotsim_ros calibrate {SENSOR_A} --trajectories 1_sphere_3 1_sphere_slide_1 "
        "2_cone_1 3_lying_cylinder_0 4_torus_1 6_round_punch_0 --hold-out 0 --workers 1 --sensor "
        f"sensor_a --fit E nu friction c20 thickness {KNOWN_NOISE} --solves 6 --out "
        "out/thickness.yaml",
    ),
    "camera_sensor_a": Study(
        5,
        command=f"dotsim_ros calibrate-camera {SENSOR_A} --sensor sensor_a --out out/camera.yaml",
    ),
    "classification": Study(60, "classification.study:classification", before=(APART,)),
    "closed_loop": Study(5, "trajectory.closed_loop:closed_loop"),
    "coupling": Study(5, "speed.coupling:coupling"),
    "coverage_units": Study(25, "gap.coverage_units:coverage_units"),
    "device_check": Study(8, "speed.device_check:device_check"),
    "drop_in": Study(6, "speed.drop_in:drop_in"),
    "environments": Study(5, "speed.environments:environments"),
    "find_gap": Study(30, "gap.search_time:find_gap"),
    "force_control": Study(5, "speed.force_control:force_control"),
    "frame_shares": Study(2, "speed.frame_shares:frame_shares", in_all=False),
    "gap": Study(31, "gap.study:gap"),
    "gap_discrepancy": Study(60, "gap.discrepancy:gap_discrepancy", in_all=False),
    "gap_images": Study(10, "gap.images_study:gap_images"),
    "gap_nulls": Study(30, "gap.nulls_study:gap_nulls"),
    "gap_open": Study(30, "gap.open_study:gap_open"),
    "gap_physics": Study(45, "gap.solved_score:gap_physics", in_all=False),
    "gap_physics_new_again/gap_physics": Study(
        45,
        "gap.solved_score:gap_physics",
        {
            "sets": Path("data/hidden_23"),
            "half": "opened",
            "cache": Path("out/search_23"),
        },
    ),
    "gap_physics_rule_9/gap_physics": Study(
        45, "gap.solved_score:gap_physics", {"half": "opened", "cache": Path("out/search_17")}
    ),
    "gap_rendered": Study(35, "gap.rendered_study:gap_rendered"),
    "gelsight": Study(10, "optics.gelsight:gelsight"),
    "gelsight_taxim": Study(10, "optics.gelsight:gelsight_taxim"),
    "geometry": Study(45, "geometry.study:geometry"),
    "geometry_later": Study(40, "geometry.study:geometry_later"),
    "grasps": Study(20, "grasps:grasps"),
    "hide": Study(800, "hidden.solved_sets:hide", in_all=False),
    "live": Study(2, "speed.live:live"),
    "loop_faults": Study(20, "trajectory.loop_faults:loop_faults"),
    "optics": Study(40, "optics.study:optics", before=(APART,)),
    "optics_network": Study(5, "optics.optics_network:optics_network"),
    "profiles": Study(10, "speed.profiles:profiles"),
    "real": Study(25, "real.record:real", in_all=False),
    "real_cylinders": Study(15, "real.cylinder_study:real_cylinders"),
    "real_force": Study(5, "real.pad_study:real_force"),
    "real_gap": Study(30, "real.altered:real_gap"),
    "real_pair": Study(5, "optics.real_pair:real_pair"),
    "realtime": Study(8, "speed.realtime:realtime"),
    "realtime_learned": Study(
        4,
        "speed.realtime:realtime",
        {"sensor": "sensor_a", "seconds": 30.0, "case_frames": 40, "start_up": False},
    ),
    "reference": Study(45, "reference.study:reference"),
    "reference_presses": Study(3, "reference.presses:reference_presses", in_all=False),
    "residual_size": Study(15, "optics.residual_size:residual_size"),
    "rl": Study(35, "rl.study:rl"),
    "runtime": Study(15, "geometry.runtime:runtime"),
    "scale_out": Study(10, "speed.scale_out:scale_out"),
    "sensors": Study(5, "speed.sensors:sensors"),
    "shear": Study(30, "reference.shear:shear"),
    "simulated_loop": Study(70, "trajectory.simulated_loop:simulated_loop"),
    "slip": Study(8, "slip:slip"),
    "slow_machine": Study(5, "speed.slow_machine:slow_machine"),
    "soak": Study(31, "speed.soak:soak"),
    "speed": Study(10, "speed.speed:speed"),
    "trajectory": Study(40, "trajectory.study:trajectory"),
    "trajectory_realtime": Study(
        25,
        "trajectory.study:trajectory",
        {"clock": "realtime", "settings": ("simulated", "transferred")},
    ),
    "tumour": Study(40, "tumour.study:tumour"),
    "unit": Study(10, "hidden.asked:unit", in_all=False),
}


def is_made(name: str, directory: Path, commit: str) -> bool:
    """Return whether the record of a study names a commit, or is sealed and stays as it is."""
    file = directory / f"{name}.json"
    if not file.is_file():
        return False
    record = json.loads(file.read_text(encoding="utf-8"))
    return record.get("sealed", False) or origin_of(record).get("commit") == commit


def run(name: str, options: Sequence[str] = (), *, json_directory: Path | None = None) -> bool:
    """Run a study, print its tables and write its record.

    Args:
        name: of the study.
        options: tokens of the command line, in place of the record's options.
        json_directory: folder of the record; None for no record.

    Returns:
        Whether it ended well.

    Raises:
        ValueError: the input is not valid; OSError: a file cannot be read or written.
        SystemExit: the options are not the function's, or only ask for help.
    """
    study = STUDIES[name]
    file = None if json_directory is None else json_directory / f"{name}.json"
    if study.command:
        written = "" if file is None else f" --json {file}"
        return _ran([*study.before, f"{study.command} {shlex.join(options)}{written}"])
    app = App(
        name=f"python -m studies {name}",
        help_format="plaintext",
        version_flags=(),
        default_parameter=Parameter(consume_multiple=True, negative_iterable=()),
    )
    own = app.default(study.load())
    function, bound, _ = app.parse_args(list(options))
    if function is not own:
        function(*bound.args, **bound.kwargs)
        return True
    if not options and not _ran(study.before):
        return False
    given = {**study.options, **bound.arguments}
    # A study may write what the tree holds; the commit is that of the tree that it began with.
    origin = provenance()
    figures = function(**given)
    record = {**origin, "options": options_of(function, given), **figures}
    print(tables_of(f"{name}.json", record))
    if file is not None:
        write_json(file, record)
    failed = figures.get(FAILED, [])
    for reason in failed:
        print(f"{name}: {reason}", file=sys.stderr)
    return not failed


def _ran(commands: Iterable[str]) -> bool:
    """Run commands one after the other; return whether all ended well."""
    for command in commands:
        print(f"$ {command}", flush=True)
        if subprocess.run(shlex.split(command), cwd=ROOT).returncode:
            return False
    return True


def options_of(function: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that a function is called with, its defaults too, as JSON has them."""
    parameters = inspect.signature(function).parameters.values()
    every = {parameter.name: parameter.default for parameter in parameters} | dict(given)
    return {name: str(v) if isinstance(v, Path) else v for name, v in every.items()}


def main(arguments: Sequence[str]) -> int:
    """Run `python -m studies`; return the exit status: 1 where a study failed."""
    words, directory = list(arguments), None
    if "--json" in words:
        place = words.index("--json")
        if place + 1 == len(words):
            return _refused("--json names no folder, expected --json DIR")
        directory = Path(words[place + 1])
        del words[place : place + 2]
    if not words or words[0] in HELP:
        print(__doc__)
        for name, study in STUDIES.items():
            print(f"{name:36} {study.minutes:3d} min  {study.summary()}")
        return 0
    names = []
    while words and not words[0].startswith("-"):
        names.append(words.pop(0))
    if names == ["all"]:
        names = [name for name, study in STUDIES.items() if study.in_all]
    if unknown := [name for name in names if name not in STUDIES]:
        return _refused(f"there is no study {', '.join(unknown)}; they are {', '.join(STUDIES)}")
    if words and len(names) > 1:
        return _refused(f"{' '.join(words)}: options are of one study, and {len(names)} are named")
    commit = commit_of(ROOT)
    is_record = directory is not None and directory.resolve() == RESULTS
    if is_record and commit.endswith("-dirty"):
        return _refused("a record names a clean commit: commit or stash the changes first")
    failed = []
    for number, name in enumerate(names, start=1):
        # With options of its own a record is made again, but never a sealed one.
        if is_record and is_made(name, RESULTS, "" if words else commit):
            print(f"{name}: made at this commit, or sealed")
            continue
        if len(names) > 1:
            print(f"{name}: {number} of {len(names)}, about {STUDIES[name].minutes} minutes")
        begun = time.monotonic()
        try:
            with extra_needed("it", "test"):
                is_well = run(name, words, json_directory=directory)
        except (ValueError, OSError, FloatingPointError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            is_well = False
        failed += [] if is_well else [name]
        if not HELP.intersection(words):
            print(f"{name}: {(time.monotonic() - begun) / 60.0:.1f} minutes", flush=True)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return min(len(failed), 1)


def _refused(reason: str) -> int:
    print(f"python -m studies: {reason}", file=sys.stderr)
    return 2
