# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The commands with arguments that make no sense: one line and a status that is not 0."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from random import Random

from dotsim_ros.cli.main import main
from fuzz.target import Finding, Target

OPTIONS: dict[str, tuple[str, ...]] = {
    "view": ("--out", "--fps", "--speed", "--columns", "--rest", "--format"),
    "calibrate": (
        "--sensor",
        "--fit",
        "--hold-out",
        "--solves",
        "--workers",
        "--noise-skin-m",
        "--ray-address",
    ),
    "find-gap": ("--sensor", "--alpha", "--candidates", "--effects", "--budget", "--channels"),
    "plan-gap": ("--sensor", "--effects", "--channels", "--workers", "--ray-address"),
    "train-optics": ("--sensor", "--size", "--epochs", "--hold-out", "--network"),
    "calibrate-camera": ("--sensor", "--hold-out", "--skin", "--stated"),
    "evaluate": ("--sensor", "--from-depth-mm", "--trajectories", "--workers", "--seed"),
    "demonstrate": ("--sensor", "--indenter", "--paths", "--episodes", "--frames", "--wander"),
    "train-policy": ("--examples", "--learning-rate", "--size", "--start"),
}
REQUIRED = {
    "view": (),
    "calibrate": ("--data", "--out"),
    "find-gap": ("--measured", "--out"),
    "plan-gap": ("--protocols", "--out"),
    "train-optics": ("--data", "--sensor", "--out"),
    "calibrate-camera": ("--data", "--out", "--sensor"),
    "evaluate": ("--data", "--out", "--sensor"),
    "demonstrate": ("--out",),
    "train-policy": ("--data", "--out"),
}
VALUES = (
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "99999999999999999999",
    "",
    " ",
    "nope",
    "../..",
    "/dev/null",
    "/proc/self/mem",
    "a\nb",
    "$x_{",
    "ü",
    "x" * 3000,
)


def _prepare(folder: Path) -> Path:
    (folder / "empty").mkdir()
    (folder / "here" / "empty").mkdir(parents=True)
    (folder / "broken").mkdir()
    (folder / "broken" / "dataset.yaml").write_text("trajectories: [{bag: gone}]")
    # What a verb imports the first time counts for no case.
    for verb in OPTIONS:
        with contextlib.suppress(Finding):
            _check([verb, *_arguments(verb, str(folder / "gone"), folder)])
    return folder


def _attempt(prepared: Path, random: Random, folder: Path) -> None:
    # No path of `VALUES` leads from here to files of this machine.
    os.chdir(prepared / "here" / "empty")
    verb = random.choice(list(OPTIONS))
    # Data that are never there: whatever the options say, nothing long can begin.
    data = str(prepared / random.choice(("gone", "empty", "broken")))
    arguments = _arguments(verb, data, folder)
    for _ in range(random.choice((1, 1, 2))):
        option = random.choice(OPTIONS[verb])
        if verb == "demonstrate" and option == "--sensor":
            continue
        arguments += [f"{option}={random.choice(VALUES)}"]
    _check([verb, *arguments])


def _arguments(verb: str, data: str, folder: Path) -> list[str]:
    """Return what a verb needs at least, with data that are not there."""
    arguments = [data] if verb == "view" else []
    for option in REQUIRED[verb]:
        value = str(folder / "out.yaml") if option == "--out" else data
        arguments += [option, "densetact2" if option == "--sensor" else value]
    if verb == "demonstrate":
        # It needs no data: a sensor that is not there ends it.
        arguments += ["--sensor", data]
    return arguments


def _check(arguments: list[str]) -> None:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        try:
            status = main(arguments)
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else 1
    words = said.getvalue()
    shown = " ".join(arguments)[:300]
    if status == 0:
        raise Finding(f"{shown}: status 0")
    last = words.strip().splitlines()[-1:]
    if not last or not last[0].startswith("dotsim_ros"):
        raise Finding(f"{shown}: ends with {words[-300:]!r}")
    if "Traceback" in words:
        raise Finding(f"{shown}: {words[-600:]!r}")


TARGETS = (Target("command", _prepare, _attempt),)
