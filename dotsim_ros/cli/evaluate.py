# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compare simulators with measured presses: geometry and force, images, or cost and error.

`geometry` fits every model on 19 presses drawn by the seed and judges it on the other 9, then
leaves each indenter out in turn; it writes geometry.md and geometry.json. `geometry_later` fits
every model on all presses of one data set and judges it on all of another that was recorded later;
it writes geometry_later.md and geometry_later.json. `runtime` lets the
implicit and the explicit gel follow a few presses at several resolutions; it writes runtime.md and
runtime.json. `optics` fits every model of the image on the frames of six splits and judges it on
their others; it writes optics.md, optics.json and sheets of images. A row that was made before is
not made again, so an interrupted run is resumed. `gelsight` does the same on real presses of a
ball on a flat sensor, `gelsight_taxim` on those of two more.
`real_pair` fits a press to one real image of a DenseTact. `gap` hides
effects in measured presses and lets the gap finder look for them; it writes gap.md and gap.json.
With `--sets` it runs the whole finder on sets that `dotsim_ros hide` made, and writes
gap_physics.md and gap_physics.json; a set that was searched before is not searched again.
`trajectory` lets a policy lead the simulated arm over ROS topics, on the sensor that it was trained
on and on others; a trial that was run before is not run again. `rl` learns policies by
reinforcement that turn a box, and judges them in worlds that they never saw; what was learnt before
is not learnt again. `classification` lets classifiers learn which indenter touches from each image
model's images, and judges them on measured ones (`--gelsight` adds real ones of a ball); a row that
was made before is not made again. `tumour` presses the sensor onto soft skins over a bulge or a
dent: classifiers learn in simulation which it is, and are judged on presses that CalculiX solved
with both bodies deformable (ccx must be installed); presses that were solved before are not solved
again. `real_force` predicts each depth of a real ball on a pad from the other ones, and says what
it cannot tell apart. `real_cylinders` fits laws to one real specimen of a gel and judges them on
another (ccx must be installed).
docs/evaluation.md says what the figures mean.

examples:
  dotsim_ros evaluate geometry --data DIR --sensor calibrated/ --out out/results
  dotsim_ros evaluate geometry --data DIR --models ours tacto --splits held_out --out out
  dotsim_ros evaluate geometry_later --data LATER --fit-data DIR --sensor FILE --out out/results
  dotsim_ros evaluate optics --data DIR --sensor sensor_a --out out/results
  dotsim_ros evaluate optics --data DIR --sensor FILE --models idle carried ours --splits hard
  dotsim_ros evaluate gelsight --data real/gelsight --out out/results
  dotsim_ros evaluate gelsight_taxim --data real/gelsight_taxim --out out/results
  dotsim_ros evaluate real_pair --data real/densetact --out out/results
  dotsim_ros evaluate gap --data DIR --sensor sensor_a --nulls 200 --out out/results
  dotsim_ros evaluate gap --sets DIR --sensor DIR/sensor_a.yaml --out out/results
  dotsim_ros evaluate runtime --data DIR --presses 1_sphere_0 2_cone_3 --out out/results
  dotsim_ros evaluate trajectory --policy densetact2_sphere --trials 10 --out out/results
  dotsim_ros evaluate rl --seeds 5 --episodes 100 --out out/results
  dotsim_ros evaluate classification --data DIR --sensor FOLDER --gelsight DIR --out out/results
  dotsim_ros evaluate tumour --presses 30 --judged 6 --out out/results
  dotsim_ros evaluate real_force --data real/gelsight_mini_force --out out/results
  dotsim_ros evaluate real_cylinders --data real/ecoflex_compression --out out/results
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dotsim_ros.cli._workers import add_worker_arguments, crew_of
from dotsim_ros.evaluation.optics.names import BLIND_OR_SLOW, CLASSIFIED_BY
from dotsim_ros.evaluation.optics.names import NAMES as IMAGE_MODELS
from dotsim_ros.evaluation.optics.names import OPTIONAL as OPTIONAL_MODELS

if TYPE_CHECKING:
    from dotsim_ros.evaluation.geometry.report import Measured
    from dotsim_ros.evaluation.optics.models import FitSettings
    from dotsim_ros.measured.split import Split

MODELS = ("ours", "explicit", "explicit_fitted", "tacto", "taxim", "difftactile")
LEVELS = ("easy", "medium", "hard")
DOMAINS = ("in_domain", "out_of_domain", "all_six")
MOTIONS = ("line", "arc", "figure_eight", "press")
SENSORS = ("simulated", "transferred", "shifted", "reality")
CLOCKS = ("simulated", "realtime")
HALVES = ("development", "opened")
BALL_MODELS = ("idle", "taxim", "taxim_cap", "fots", "fots_cap", "carried", "local", "ours")
RUNTIME_PRESS_COUNT = 3
ROLLOUT_EPISODES = 4
SEEN = ("depth", "image")
SOFT_SKINS = ("skin_1", "skin_2", "skin_3")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    subjects = parser.add_subparsers(dest="subject", required=True, metavar="SUBJECT")
    geometry = subjects.add_parser("geometry", help="surfaces and forces of every model")
    later = subjects.add_parser(
        "geometry_later", help="the same on presses recorded after those that are fitted on"
    )
    optics = subjects.add_parser("optics", help="images of every model")
    runtime = subjects.add_parser("runtime", help="frames a second against the error")
    gelsight = subjects.add_parser("gelsight", help="images of a real flat sensor")
    gelsight_taxim = subjects.add_parser("gelsight_taxim", help="images of two more")
    real_pair = subjects.add_parser("real_pair", help="one real image, explained by a press")
    gap = subjects.add_parser("gap", help="the gap finder on hidden effects")
    classification = subjects.add_parser(
        "classification", help="which indenter touches, learnt from simulated images"
    )
    real_force = subjects.add_parser("real_force", help="forces of a real ball on a pad")
    real_force.add_argument(
        "--at-mm",
        nargs="+",
        type=float,
        default=[1.5],
        metavar="MM",
        help="further depths to predict, from all that were measured (1.5)",
    )
    real_cylinders = subjects.add_parser("real_cylinders", help="laws of real gels, between plates")
    balls = (gelsight, gelsight_taxim)
    on_data = (geometry, later, optics, *balls, real_pair, runtime, gap)
    for subject in (*on_data, classification, real_force, real_cylinders):
        subject.add_argument(
            "--data", type=Path, required=subject is not gap, help="folder of a data set"
        )
        subject.add_argument(
            "--out", type=Path, default=Path("out/results"), help="folder of the files"
        )
        subject.add_argument("--json", type=Path, help="write the figures here as well")
        subject.add_argument("--seed", type=int, default=0, help="seed of the draws (0)")
    for subject in (geometry, later, optics, real_pair, runtime, gap, classification):
        subject.add_argument(
            "--sensor",
            default="densetact2",
            help="name or file of the sensor (densetact2), or a folder with a file for each split: "
            "held_out.yaml and INDENTER.yaml for geometry, LEVEL.yaml for optics, DOMAIN.yaml for "
            "classification",
        )
    gap.add_argument("--nulls", type=int, default=200, help="cases without an effect (200)")
    gap.add_argument("--repeats", type=int, default=6, help="cases of each law and size (6)")
    gap.add_argument(
        "--laws", nargs="+", help="hidden laws (those that are no formula of the library)"
    )
    gap.add_argument(
        "--sets",
        type=Path,
        metavar="DIR",
        help="in place of --data: sets that dotsim_ros hide made; each is searched once by the "
        "whole finder, and gap_physics.md and gap_physics.json are written",
    )
    gap.add_argument(
        "--half",
        choices=HALVES,
        default=HALVES[0],
        help="of the sets; the other one is to be opened once, when nothing is changed any more "
        "(development)",
    )
    add_worker_arguments(gap)
    for subject in (gap, real_force):
        subject.add_argument("--run", type=Path, help="folder of the solves (the user's cache)")
    gap.add_argument(
        "--fit-discrepancy",
        type=Path,
        metavar="FILE",
        help="only estimate the model's own error and the effects' limits, and write them here",
    )
    gap.add_argument(
        "--representative",
        action="store_true",
        help="with --fit-discrepancy: the presses differ as the units do that will be searched "
        "(they are of several, or of several meshes of a solver): limits need no margin for that",
    )
    gap.add_argument(
        "--discrepancy",
        type=Path,
        metavar="FILE",
        help="with --sets: the twin's own error, as --fit-discrepancy writes it (the shipped one)",
    )
    later.add_argument(
        "--fit-data",
        type=Path,
        required=True,
        help="folder of the data set to fit on, of the same sensor, with its indenters' meshes",
    )
    for subject in (geometry, later):
        subject.add_argument(
            "--models", nargs="+", choices=MODELS, default=list(MODELS), help="which (all)"
        )
        subject.add_argument(
            "--stated",
            default="densetact2",
            help="sensor as its maker states it, for the explicit gels",
        )
        subject.add_argument(
            "--from-depth-mm",
            type=float,
            default=2.0,
            help="least depth of the frames that are judged (2)",
        )
    geometry.add_argument(
        "--splits",
        choices=("held_out", "all"),
        default="all",
        help="the drawn one only, or with each indenter left out as well (all)",
    )
    geometry.add_argument("--count", type=int, default=9, help="presses held out (9)")
    _add_trajectory_arguments(
        subjects.add_parser("trajectory", help="paths that a policy follows by touch")
    )
    _add_rl_arguments(subjects.add_parser("rl", help="a box turned by touch, learnt with PPO"))
    _add_tumour_arguments(
        subjects.add_parser("tumour", help="a bulge or a dent below a soft skin, told by touch")
    )
    _add_optics_arguments(optics)
    for subject in balls:
        subject.add_argument(
            "--models",
            nargs="+",
            choices=BALL_MODELS,
            default=list(BALL_MODELS),
            help="which (all)",
        )
        subject.add_argument(
            "--images", type=Path, default=Path("docs/images"), help="folder of the sheets"
        )
    gelsight.add_argument("--count", type=int, default=8, help="presses held out (8)")
    _add_classification_arguments(classification)
    for subject in (optics, *balls, classification):
        _add_network_arguments(subject)
    runtime.add_argument(
        "--presses",
        nargs="+",
        metavar="NAME",
        help=f"which (the first {RUNTIME_PRESS_COUNT} held out, each of another indenter)",
    )


def _add_optics_arguments(optics: argparse.ArgumentParser) -> None:
    optics.add_argument(
        "--models",
        nargs="+",
        choices=IMAGE_MODELS,
        default=[name for name in IMAGE_MODELS if name not in OPTIONAL_MODELS],
        help=f"which (all but {', '.join(OPTIONAL_MODELS)})",
    )
    optics.add_argument(
        "--splits", nargs="+", choices=LEVELS, default=list(LEVELS), help="which (all)"
    )
    optics.add_argument(
        "--images",
        type=Path,
        default=Path("docs/images"),
        help="folder of the sheets (docs/images)",
    )


def _add_classification_arguments(classification: argparse.ArgumentParser) -> None:
    add = classification.add_argument
    add(
        "--models",
        nargs="+",
        choices=CLASSIFIED_BY,
        default=[name for name in CLASSIFIED_BY if name not in BLIND_OR_SLOW],
        help=f"which (all but {', '.join(BLIND_OR_SLOW)})",
    )
    add("--domains", nargs="+", choices=DOMAINS, default=list(DOMAINS), help="which (all)")
    add("--classifiers", type=int, default=5, help="of each row (5)")
    add("--presses", type=int, default=60, help="simulated presses of each indenter (60)")
    add("--epochs", type=int, default=60, help="of a classifier's training (60)")
    add_worker_arguments(classification)
    add(
        "--gelsight",
        type=Path,
        metavar="DIR",
        help="real presses of a ball on a flat sensor, to be told as well (left out)",
    )
    add("--images", type=Path, default=Path("docs/images"), help="folder of the picture")


def _add_trajectory_arguments(trajectory: argparse.ArgumentParser) -> None:
    add = trajectory.add_argument
    add("--policy", default="densetact2_sphere", help="folder or name of the policy")
    add("--trials", type=int, default=10, help="trials of each path in each setting (10)")
    add("--paths", nargs="+", choices=MOTIONS, default=list(MOTIONS), help="which (all)")
    add("--settings", nargs="+", choices=SENSORS, default=list(SENSORS), help="which (all)")
    add("--seconds", type=float, default=12.0, help="duration of a trial with its approach (12)")
    add("--seed", type=int, default=0, help="seed of the starts (0)")
    add(
        "--clock",
        choices=CLOCKS,
        default=CLOCKS[0],
        help="how time passes (simulated); in real time the table is trajectory_realtime",
    )
    add("--out", type=Path, default=Path("out/results"), help="folder of the files")
    add("--images", type=Path, default=Path("docs/images"), help="folder of the image")
    add("--json", type=Path, help="write the figures here as well")
    add("--cache", type=Path, help="folder of the trials run before (the user's cache)")


def _add_rl_arguments(rl: argparse.ArgumentParser) -> None:
    add = rl.add_argument
    add("--seeds", type=int, default=5, help="policies learnt (5)")
    add("--steps", type=int, default=8_000, help="of the world, for each policy (8000)")
    add("--minutes", type=float, default=60.0, help="limit of each training (60)")
    add("--episodes", type=int, default=100, help="each policy is judged on (100)")
    add("--observation", choices=SEEN, default=SEEN[0], help=f"what policies see ({SEEN[0]})")
    add("--image-size", type=int, default=32, help="width and height of the image, pixels (32)")
    add(
        "--try",
        dest="tried",
        nargs="+",
        action="append",
        default=[],
        metavar=("SETTING", "VALUE"),
        help="learn once with each value first, in every combination where --try is given for "
        "several settings, and go on with what does best on episodes that nothing else is judged "
        "on: learning_rate, discount, entropy_share, rollout, epochs, mini_batches",
    )
    add_worker_arguments(rl)
    add("--out", type=Path, default=Path("out/results"), help="folder of the files")
    add("--images", type=Path, default=Path("docs/images"), help="folder of the pictures")
    add("--json", type=Path, help="write the figures here as well")
    add("--cache", type=Path, help="folder of what was learnt before (the user's cache)")


def _add_tumour_arguments(tumour: argparse.ArgumentParser) -> None:
    add = tumour.add_argument
    add("--sensor", default="densetact2", help="name or file of the sensor, a dome (densetact2)")
    add("--skins", nargs="+", choices=SOFT_SKINS, default=list(SOFT_SKINS), help="which (all)")
    add("--presses", type=int, default=30, help="simulated presses to learn from, each class (30)")
    add("--judged", type=int, default=6, help="presses that CalculiX solves, each class (6)")
    add("--shifted", type=int, default=2, help="presses for each changed skin, each class (2)")
    add("--classifiers", type=int, default=3, help="of each skin (3)")
    add("--epochs", type=int, default=25, help="of a classifier's training (25)")
    add("--seed", type=int, default=0, help="seed of the draws (0)")
    add("--out", type=Path, default=Path("out/results"), help="folder of the files")
    add("--images", type=Path, default=Path("docs/images"), help="folder of the picture")
    add("--json", type=Path, help="write the figures here as well")
    add("--cache", type=Path, help="folder of the presses solved before (the user's cache)")


def _add_network_arguments(subject: argparse.ArgumentParser) -> None:
    subject.add_argument(
        "--network-epochs",
        type=int,
        help="of a published network's training (the network's own number, 100)",
    )
    subject.add_argument(
        "--network-width",
        type=int,
        help="width of the published networks' images, pixels (the network's own)",
    )
    subject.add_argument(
        "--cache",
        type=Path,
        help="folder of the rows made before, and of trainings (the user's cache)",
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
    from dotsim_ros.files import write_json, write_text
    from dotsim_ros.provenance import provenance

    figures["provenance"] = provenance() | {"data": arguments.data.name} | origin
    page = page_of(figures)
    for path in filter(None, (arguments.out / f"{arguments.subject}.json", arguments.json)):
        write_json(path, figures)
    write_text(arguments.out / f"{arguments.subject}.md", page)
    print(page)
    return 0


def _geometry(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.geometry.report import read_measured, splits_of
    from dotsim_ros.measured.data_set import read_data_set

    measured = read_measured(read_data_set(arguments.data))
    splits = splits_of(
        measured,
        count=arguments.count,
        seed=arguments.seed,
        with_indenters=arguments.splits == "all",
    )
    return _judge_geometry(arguments, measured, splits)


def _geometry_later(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.geometry.report import read_with_later
    from dotsim_ros.measured.data_set import read_data_set

    measured, split = read_with_later(
        read_data_set(arguments.fit_data), read_data_set(arguments.data)
    )
    return _judge_geometry(arguments, measured, [split], fitted_on=arguments.fit_data.name)


def _judge_geometry(
    arguments: argparse.Namespace,
    measured: Measured,
    splits: Sequence[Split],
    *,
    fitted_on: str | None = None,
) -> int:
    from dotsim_ros.evaluation.geometry.registry import factories_of
    from dotsim_ros.evaluation.geometry.report import evaluate_geometry, geometry_page

    factories = factories_of(arguments.models, sensor=arguments.sensor, stated=arguments.stated)
    from_depth_m = 1e-3 * arguments.from_depth_mm
    origin = {"sensor": str(arguments.sensor), "seed": str(arguments.seed)}
    if fitted_on is not None:
        origin["fitted_on"] = fitted_on
    figures = evaluate_geometry(
        measured,
        splits,
        factories,
        seed=arguments.seed,
        from_depth_m=from_depth_m,
        progress=_say,
    )
    models = [name for name in MODELS if name in figures]
    return _write(arguments, figures, origin, lambda f: geometry_page(f, models))


def _optics(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.geometry.registry import sensor_file
    from dotsim_ros.evaluation.optics.judge import ceilings, splits_of
    from dotsim_ros.evaluation.optics.models import FitSettings
    from dotsim_ros.evaluation.optics.report import evaluate_optics, joined, optics_page
    from dotsim_ros.evaluation.optics.rows import RowMaker
    from dotsim_ros.evaluation.optics.sheet import write_sheets
    from dotsim_ros.evaluation.optics.source import clipped_presses, refined_data
    from dotsim_ros.evaluation.optics.split import WAYS
    from dotsim_ros.files import cache_directory
    from dotsim_ros.measured.data_set import read_data_set
    from dotsim_ros.optics.idle import lights_of
    from dotsim_ros.optics.idle_check import read_idle_images
    from dotsim_ros.specification import load_sensor
    from dotsim_ros.twin.footage import camera_for, read_filmed_data, render_filmed

    settings = FitSettings(arguments.seed, arguments.network_epochs, arguments.network_width)
    data_set = read_data_set(arguments.data)

    # One at a time: the frames of one take half a gigabyte.
    @lru_cache(maxsize=1)
    def maker_of(file: Path | str) -> RowMaker:
        sensor = load_sensor(file)
        filmed = read_filmed_data(arguments.data, sensor, progress=_say)
        camera = camera_for(sensor, filmed.idle, str(arguments.data))
        lighting, vignetting = lights_of(sensor)
        data = render_filmed(filmed, camera, lighting=lighting, vignetting=vignetting)
        return RowMaker(
            data,
            cache(lambda: clipped_presses(data_set, sensor, data)),
            lru_cache(maxsize=1)(lambda split: refined_data(filmed, sensor, data, split)),
            arguments.cache or cache_directory() / "optics",
            settings,
            _say,
        )

    origin = {
        "sensor": str(arguments.sensor),
        "seed": str(arguments.seed),
        "network_epochs": str(arguments.network_epochs),
        "network_width": str(arguments.network_width),
    }
    files = {level: sensor_file(level, arguments.sensor) for level in arguments.splits}
    figures: dict[str, Any] = {}
    sheets: dict[str, str] = {}
    for level, file in files.items():
        maker = maker_of(file)
        drawn = splits_of(maker.data, seed=arguments.seed)[level]
        part, rows = evaluate_optics(
            maker, [drawn[way] for way in WAYS], arguments.models, sensor=str(file)
        )
        figures = joined(figures, part)
        sheets |= write_sheets(arguments.images, maker, rows, seen_from=arguments.out)
    # The measured images decide these, so that any level's data will do.
    figures["ceiling"] = ceilings(maker.data, read_idle_images(data_set.idle_images()))
    return _write(arguments, figures, origin, lambda f: optics_page(f, sheets))


def _gelsight(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.optics.gelsight import evaluate_gelsight, gelsight_page

    settings, state, origin = _ball_settings(arguments)
    figures = evaluate_gelsight(
        arguments.data,
        models=arguments.models,
        settings=settings,
        state=state,
        held_out=arguments.count,
        sheets=arguments.images,
        progress=_say,
    )
    return _write(arguments, figures, origin, gelsight_page)


def _gelsight_taxim(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.optics.gelsight import evaluate_gelsight_taxim, gelsight_taxim_page

    settings, state, origin = _ball_settings(arguments)
    figures = evaluate_gelsight_taxim(
        arguments.data,
        models=arguments.models,
        settings=settings,
        state=state,
        sheets=arguments.images,
        progress=_say,
    )
    return _write(arguments, figures, origin, gelsight_taxim_page)


def _ball_settings(arguments: argparse.Namespace) -> tuple[FitSettings, Path, dict[str, str]]:
    from dotsim_ros.evaluation.optics.models import FitSettings
    from dotsim_ros.files import cache_directory

    settings = FitSettings(arguments.seed, arguments.network_epochs, arguments.network_width)
    state = (arguments.cache or cache_directory() / "optics") / f"gelsight-{arguments.seed}"
    origin = {
        "seed": str(arguments.seed),
        "network_epochs": str(arguments.network_epochs),
        "network_width": str(arguments.network_width),
    }
    return settings, state, origin


def _gap(arguments: argparse.Namespace) -> int:
    if (arguments.data is None) == (arguments.sets is None):
        raise ValueError(
            "name a data set without an effect with --data, or hidden sets with --sets"
        )
    if arguments.sets is not None:
        return _gap_sets(arguments)
    if arguments.discrepancy is not None:
        raise ValueError(
            "--discrepancy is of hidden sets; with --data it is estimated from half of the presses"
        )
    from dotsim_ros.evaluation.gap.discrepancy import calibrated_discrepancy
    from dotsim_ros.evaluation.gap.hidden.laws import LAWS, OTHER_LAWS
    from dotsim_ros.evaluation.gap.page import gap_page
    from dotsim_ros.evaluation.gap.presses import Source
    from dotsim_ros.evaluation.gap.study import run_study
    from dotsim_ros.files import cache_directory
    from dotsim_ros.gap.presses.covariance import save_discrepancy
    from dotsim_ros.measured.data_set import read_data_set
    from dotsim_ros.progress import PrintedProgress
    from dotsim_ros.specification import load_sensor

    sensor = load_sensor(arguments.sensor)
    run = arguments.run or cache_directory() / "gap"
    source = Source(arguments.data, sensor, run, crew_of(arguments), PrintedProgress())
    if arguments.fit_discrepancy is not None:
        names = [entry.name for entry in read_data_set(arguments.data).entries]
        found = calibrated_discrepancy(
            source, names, arguments.seed, is_representative=arguments.representative
        )
        save_discrepancy(found, arguments.fit_discrepancy)
        print(f"{arguments.fit_discrepancy}: {found.source}")
        return 0
    unknown = sorted(set(arguments.laws or ()) - set(LAWS))
    if unknown:
        raise ValueError(f"no law {', '.join(unknown)}; known are {', '.join(LAWS)}")
    run.mkdir(parents=True, exist_ok=True)
    figures = run_study(
        source,
        nulls=arguments.nulls,
        repeats=arguments.repeats,
        seed=arguments.seed,
        laws=tuple(arguments.laws or OTHER_LAWS),
    )
    return _write(arguments, figures, {"sensor": str(arguments.sensor)}, gap_page)


def _gap_sets(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.gap.solved_page import solved_page
    from dotsim_ros.evaluation.gap.solved_score import ScoreRequest, score_sets
    from dotsim_ros.files import cache_directory, write_json, write_text
    from dotsim_ros.provenance import provenance
    from dotsim_ros.specification import load_sensor

    request = ScoreRequest(
        arguments.sets,
        arguments.half,
        load_sensor(arguments.sensor),
        arguments.run or cache_directory() / "gap_physics" / arguments.sets.resolve().name,
        crew_of(arguments),
        arguments.discrepancy,
    )
    figures = score_sets(request, _say) | {"provenance": provenance()}
    whole = {"halves": {arguments.half: figures}, "provenance": figures["provenance"]}
    page = solved_page(whole)
    table = "gap_physics" if arguments.half == HALVES[1] else f"gap_physics_{arguments.half}"
    for path in filter(None, (arguments.out / f"{table}.json", arguments.json)):
        write_json(path, whole)
    write_text(arguments.out / f"{table}.md", page)
    print(page)
    return 0


def _real_force(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.real_force.pad_study import evaluate_pad, pad_page
    from dotsim_ros.files import cache_directory

    figures = evaluate_pad(
        arguments.data,
        run=arguments.run or cache_directory() / "real_force",
        seed=arguments.seed,
        at_mm=arguments.at_mm,
        progress=_say,
    )
    return _write(arguments, figures, {"seed": str(arguments.seed)}, pad_page)


def _real_cylinders(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.real_force.cylinder_study import cylinders_page, evaluate_cylinders

    figures = evaluate_cylinders(arguments.data, progress=_say)
    return _write(arguments, figures, {}, cylinders_page)


def _real_pair(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.optics.real_pair import (
        evaluate_real_pair,
        read_real_pair,
        real_pair_page,
    )
    from dotsim_ros.files import parameter_path
    from dotsim_ros.optics.idle import read_description
    from dotsim_ros.specification import load_sensor

    description = parameter_path("images/densetact_real_idle.yaml")
    disc, lighting, vignetting = read_description(description)
    if disc is None:
        raise ValueError(f"{description} does not say where the lit disc lies")
    figures = evaluate_real_pair(
        read_real_pair(arguments.data),
        load_sensor(arguments.sensor),
        disc,
        lighting,
        vignetting,
        progress=_say,
    )
    return _write(arguments, figures, {"sensor": str(arguments.sensor)}, real_pair_page)


def _runtime(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.geometry.report import read_measured, splits_of
    from dotsim_ros.evaluation.geometry.runtime import runtime_page, runtime_rows
    from dotsim_ros.measured.data_set import read_data_set
    from dotsim_ros.specification import load_sensor

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


def _trajectory(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.trajectory.page import trajectory_page, write_grid
    from dotsim_ros.evaluation.trajectory.trials import (
        TrialPlan,
        limits_shown,
        run_trials,
        setting_of,
        trajectory_figures,
    )
    from dotsim_ros.files import cache_directory, write_json, write_text
    from dotsim_ros.nodes.common.transport import stay_local
    from dotsim_ros.nodes.loop.trials import TrialLoop
    from dotsim_ros.nodes.tactile_policy.files import policy_folder
    from dotsim_ros.provenance import provenance
    from dotsim_ros.tasks.policy.card import read_policy

    stay_local()
    folder = policy_folder(arguments.policy)
    card, _ = read_policy(folder)
    cache = arguments.cache or cache_directory() / "trajectory"
    plan = TrialPlan(
        tuple(setting_of(name, cache, trained_on=card.sensor) for name in arguments.settings),
        tuple(arguments.paths),
        trial_count=arguments.trials,
        seconds=arguments.seconds,
        seed=arguments.seed,
        policy=card.weights_sha256,
        clock=arguments.clock,
    )
    with TrialLoop(folder, clock=arguments.clock) as loop:
        trials = run_trials(plan, loop, loop.limits, cache, progress=_say)
    name = "closed_loop" if arguments.clock == CLOCKS[0] else "closed_loop_realtime"
    image = arguments.images / f"{name}.png"
    write_grid(image, trials.recordings)
    figures = trajectory_figures(plan, trials) | {
        "plan": {"trials": plan.trial_count, "seconds": plan.seconds, "paths": list(plan.paths)},
        "limits": limits_shown(loop.limits),
        "clock": arguments.clock,
        "provenance": provenance() | {"policy": card.name, "seed": str(arguments.seed)},
    }
    page = trajectory_page(figures, os.path.relpath(image, arguments.out))
    table = "trajectory" if arguments.clock == CLOCKS[0] else "trajectory_realtime"
    for path in filter(None, (arguments.out / f"{table}.json", arguments.json)):
        write_json(path, figures)
    write_text(arguments.out / f"{table}.md", page)
    print(page)
    return 0


def _classification(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.classification.classifier import ClassifierSettings
    from dotsim_ros.evaluation.classification.page import classification_page
    from dotsim_ros.evaluation.classification.pictures import write_confusions
    from dotsim_ros.evaluation.classification.presses import PressPlan
    from dotsim_ros.evaluation.classification.real_ball import BallStudy, evaluate_real_ball
    from dotsim_ros.evaluation.classification.study import Study, run_study
    from dotsim_ros.evaluation.optics.models import FitSettings
    from dotsim_ros.files import cache_directory

    study = Study(
        arguments.data,
        str(arguments.sensor),
        models=tuple(arguments.models),
        domains=tuple(arguments.domains),
        seeds=arguments.classifiers,
        plan=PressPlan(count=arguments.presses, seed=arguments.seed),
        classifier=ClassifierSettings(epochs=arguments.epochs),
        fit=FitSettings(arguments.seed, arguments.network_epochs, arguments.network_width),
    )
    kept = arguments.cache or cache_directory() / "classification"
    figures = run_study(study, kept, workers=crew_of(arguments), tell=_say)
    if arguments.gelsight is not None:
        ball = BallStudy(
            arguments.gelsight,
            seeds=study.seeds,
            classifier=study.classifier,
            fit=study.fit,
        )
        figures["real_ball"] = evaluate_real_ball(ball, kept / "real_ball", tell=_say)
    picture = arguments.images / "classification.png"
    write_confusions(picture, figures, study.domains)
    page = partial(classification_page, picture=os.path.relpath(picture, arguments.out))
    return _write(arguments, figures, {"sensor": study.sensor}, page)


def _rl(arguments: argparse.Namespace) -> int:
    from dotsim_ros.evaluation.rl.page import rl_page
    from dotsim_ros.evaluation.rl.pictures import write_curve, write_rollout
    from dotsim_ros.evaluation.rl.study import Study, kept_folder, policy_folder, run_study
    from dotsim_ros.evaluation.rl.sweep import run_sweep
    from dotsim_ros.files import cache_directory, write_json, write_text
    from dotsim_ros.provenance import provenance
    from dotsim_ros.tasks.environments.reinforcement import PpoSettings

    size = [arguments.image_size] * 2
    study = Study(
        PpoSettings(options={"observation": arguments.observation, "image_size_px": size}),
        seeds=arguments.seeds,
        steps=arguments.steps,
        seconds=60.0 * arguments.minutes,
        episodes=arguments.episodes,
    )
    kept, crew = arguments.cache or cache_directory() / "rl", crew_of(arguments)
    sweep = None
    if arguments.tried:
        study, sweep = run_sweep(study, _tried(arguments.tried), kept, workers=crew, tell=_say)
    folder = kept_folder(study, kept)
    figures = run_study(study, folder, workers=crew, tell=_say)
    if sweep is not None:
        figures["sweep"] = sweep
    figures["provenance"] = provenance()
    curve, rollout = arguments.images / "rl_curve.png", arguments.images / "rl_rollout.gif"
    write_curve(curve, figures["learnt"])
    write_rollout(
        rollout, study.settings, policy_folder(folder, 0), study.judged_on()[:ROLLOUT_EPISODES]
    )
    page = rl_page(
        figures, *(os.path.relpath(picture, arguments.out) for picture in (curve, rollout))
    )
    for path in filter(None, (arguments.out / "rl.json", arguments.json)):
        write_json(path, figures)
    write_text(arguments.out / "rl.md", page)
    print(page)
    return 0


def _tried(given: list[list[str]]) -> dict[str, list[float]]:
    """Return the values to try by the name of the setting.

    Raises:
        ValueError: a value is no number, or a setting is named twice.
    """
    values: dict[str, list[float]] = {}
    for name, *texts in given:
        if name in values:
            raise ValueError(f"--try {name} is given twice, expected all its values in one")
        try:
            values[name] = [float(text) for text in texts]
        except ValueError as error:
            raise ValueError(f"--try {name}: {error}, expected numbers") from error
    return values


def _tumour(arguments: argparse.Namespace) -> int:
    from dataclasses import replace

    from dotsim_ros.evaluation.tumour.page import tumour_page
    from dotsim_ros.evaluation.tumour.pictures import write_presses
    from dotsim_ros.evaluation.tumour.skins import PressPlan
    from dotsim_ros.evaluation.tumour.study import TRAINING, Study, run_study
    from dotsim_ros.files import cache_directory, write_json, write_text
    from dotsim_ros.provenance import provenance
    from dotsim_ros.reference.run import calculix_path, calculix_version

    calculix_path()
    study = Study(
        str(arguments.sensor),
        skins=tuple(arguments.skins),
        seeds=arguments.classifiers,
        presses=arguments.presses,
        judged=arguments.judged,
        shifted=arguments.shifted,
        plan=PressPlan(seed=arguments.seed),
        classifier=replace(TRAINING, epochs=arguments.epochs),
    )
    cache = arguments.cache or cache_directory() / "tumour"
    figures = run_study(study, cache, _say)
    figures["provenance"] = provenance() | {
        "seed": str(arguments.seed),
        "calculix": calculix_version(),
    }
    picture = arguments.images / "tumour.png"
    write_presses(picture, study, cache, _say)
    page = tumour_page(figures, os.path.relpath(picture, arguments.out))
    for path in filter(None, (arguments.out / "tumour.json", arguments.json)):
        write_json(path, figures)
    write_text(arguments.out / "tumour.md", page)
    print(page)
    return 0


_SUBJECTS = {
    "geometry": _geometry,
    "geometry_later": _geometry_later,
    "optics": _optics,
    "gelsight": _gelsight,
    "gelsight_taxim": _gelsight_taxim,
    "real_pair": _real_pair,
    "real_force": _real_force,
    "real_cylinders": _real_cylinders,
    "gap": _gap,
    "runtime": _runtime,
    "trajectory": _trajectory,
    "rl": _rl,
    "classification": _classification,
    "tumour": _tumour,
}
