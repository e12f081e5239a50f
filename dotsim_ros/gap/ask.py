# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The search that asks: a command records what would decide most, until the answer is sure."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros.data.data_set import INDEX, SKIN_MESH, DataSet, DataSetEntry, read_data_set
from dotsim_ros.data.reading import PressReader
from dotsim_ros.gap.find import find_gap
from dotsim_ros.gap.findings import Findings, Question
from dotsim_ros.gap.next_presses import FOLDER
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import is_definition
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import write_text
from dotsim_ros.io.replacement import keep
from dotsim_ros.specification import SensorSpecification, given_sensor

GROWN = "asked"
"""Folder below that of the report: the data set with what was asked for."""
RECORDING = "recording"
"""Folder in it that a command records into."""


def search_and_ask(
    measured: Path,
    command: str,
    *,
    sensor: str | Path | SensorSpecification,
    out: Path,
    indenters: Path | None = None,
    next_presses: int,
    rounds: int,
    announce: Callable[[str], None],
    **options: Any,
) -> Findings:
    """Search, have recorded what would decide most, and go on, until the answer is sure or nothing
    more can be asked for.

    What was recorded is kept in `out/asked`, a data set of the measured trajectories, by their
    paths, and the new ones; an interrupted call goes on from there.

    Args:
        measured: folder of the data set; it stays as it is.
        command: is called with the folder of the trajectories to record, `out/next`, and the one
            to record into, where it leaves a bag of the name of each.
        sensor, indenters: as for `find_gap`.
        out: folder of the report, that of the last search.
        next_presses: so many trajectories are asked for at a time, 1 or more.
        rounds: so often at most.
        announce: called with a line a round.
        options: further ones of `find_gap`.

    Raises:
        ValueError: the command failed or left no bag that can be used, or `out/asked` is of
            another data set; the report of the search before and all bags stay. Or as `find_gap`.
        FileNotFoundError: as `find_gap`.
    """
    if rounds < 1:
        raise ValueError(f"rounds is {rounds}, expected 1 or more")
    own, grown = read_data_set(measured), out / GROWN
    twin = given_sensor(sensor)
    for number in range(rounds + 1):
        data_set = read_data_set(grown) if (grown / INDEX).is_file() else own
        there = {entry.bag.resolve() for entry in data_set.entries}
        if not {entry.bag.resolve() for entry in own.entries} <= there:
            raise ValueError(
                f"{grown} goes on from another data set than {measured}: give another --out"
            )
        asks = next_presses if number < rounds else 0
        findings = find_gap(
            data_set, sensor=twin, out=out, indenters=indenters, next_presses=asks, **options
        )
        if not findings.questions:
            break
        if data_set is own:
            _begin(own, grown, indenters)
            data_set = read_data_set(grown)
        names = ", ".join(question.name for question in findings.questions)
        announce(f"{findings.sentence} Round {number + 1} of {rounds}: {names}")
        reader = PressReader.of(data_set, skin_of(twin.gel), indenters=indenters)
        _record(command, out / FOLDER, reader, findings.questions)
    return findings


def _begin(data_set: DataSet, folder: Path, indenters: str | Path | None) -> None:
    """Make a data set that lists the bags of another one where they are."""
    own = data_set.directory
    (folder / "bags").mkdir(parents=True, exist_ok=True)
    (folder / "indenters").mkdir(exist_ok=True)
    names = {entry.indenter for entry in data_set.entries}
    for name in names:
        if not is_definition(name):
            shutil.copy(data_set.indenter_file(name, indenters), folder / "indenters")
    for file in (own / SKIN_MESH, *data_set.idle_images()):
        if file.is_file():
            shutil.copy(file, folder)
    content = read_yaml(own / INDEX)
    for record in (*content["trajectories"], *content.get("weights", ())):
        record["bag"] = str((own / record["bag"]).resolve())
    write_text(folder / INDEX, yaml.safe_dump(content, sort_keys=False))


def _record(
    command: str, planned: Path, reader: PressReader, questions: Sequence[Question]
) -> None:
    """Have trajectories recorded, and add their bags to a reader's data set once all can be used.

    Raises:
        ValueError: the command fails, or leaves no bag that can be used.
    """
    grown = reader.data_set.directory
    folder = grown / RECORDING
    _empty(folder)
    folder.mkdir()
    try:
        ended = subprocess.run(
            [*shlex.split(command), str(planned.resolve()), str(folder.resolve())], check=False
        ).returncode
    except OSError as error:
        raise ValueError(f"--ask {command} cannot be run: {error}; name a program") from error
    if ended:
        raise ValueError(
            f"--ask {command} ended with status {ended}, expected 0 and a bag of each trajectory "
            f"in {planned}: mend it and run the same line again"
        )
    content = read_yaml(grown / INDEX)
    for question in questions:
        frame = reader.data_set.entries[0].base_frame
        bag = folder / question.name
        try:
            reader.read(DataSetEntry(bag.name, bag, question.indenter, 0, False, frame))
        except (FileNotFoundError, ValueError) as error:
            raise ValueError(f"--ask {command} left no bag that can be used: {error}") from error
        content["trajectories"].append(
            {"bag": f"bags/{question.name}", "indenter": question.indenter}
        )
    for question in questions:
        os.replace(folder / question.name, grown / "bags" / question.name)
    write_text(grown / INDEX, yaml.safe_dump(content, sort_keys=False))
    _empty(folder)


def _empty(folder: Path) -> None:
    """Remove a folder, or put what a command left there aside."""
    with suppress(OSError):
        folder.rmdir()
    if folder.exists():
        keep(folder)
