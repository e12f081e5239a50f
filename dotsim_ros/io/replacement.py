# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files of a folder that are replaced all together, and folders that are removed only by who made
them.

A reader of the folder, at whatever moment the writer is killed or the disk is full, finds all files
of the call before, all of the new one, or a part of either; never files of both. What a user has
put there, or has changed, is never lost.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import no_room_named, write_json

MANIFEST = ".report_files.json"
"""Names and SHA-256 of the files that a report wrote into its folder."""
STAGED = ".report_new"
"""The next files, next to those of before; whole once they include their manifest."""
SET_ASIDE = ".report_before"
"""The files of before, from when the next ones are whole until they are in place."""
ABSENT = ""
"""Stands in the manifest for a file that must not be there."""
MADE = ".made.json"
"""What a command made below a folder: by name of the sub-folder, SHA-256 by relative path."""


def replace_files(
    directory: str | Path, files: Mapping[str, bytes | None], *, keep_as: str | None = None
) -> None:
    """Write files into a folder in place of those of the call before, all of them or none.

    They are written next to the old ones first; a full disk or a kill leaves those as they are.
    Then the old ones are moved out, and after that the new ones in, so that no moment shows files
    of both. What is interrupted there is brought to its end by the next call, or by
    `finish_replacement`.

    A file in the way that no call wrote, or that has changed since, is kept as `NAME.kept`; one
    that is not in the way is left alone.

    Args:
        directory: made where it is absent; it keeps what was written in `MANIFEST`.
        files: contents by name; None where no file of this name may stay.
        keep_as: name of a folder for the files of before, with a number where it is there already;
            None removes them.

    Raises:
        OSError: they could not be written; the folder is as it was.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    with _alone(directory):
        _finish(directory)
        staged = directory / STAGED
        shutil.rmtree(staged, ignore_errors=True)
        try:
            with no_room_named(directory):
                _stage(staged, files)
        except BaseException:
            shutil.rmtree(staged, ignore_errors=True)
            raise
        _switch(directory, keep_as)


def _stage(staged: Path, files: Mapping[str, bytes | None]) -> None:
    staged.mkdir()
    written = {name: content for name, content in files.items() if content is not None}
    for name, content in written.items():
        with (staged / name).open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    absent = dict.fromkeys(files.keys() - written.keys(), ABSENT)
    digests = {name: _digest(content) for name, content in written.items()}
    write_json(staged / MANIFEST, absent | digests)


def finish_replacement(directory: str | Path) -> None:
    """Bring an interrupted replacement to its end, so that the folder shows the new files."""
    directory = Path(directory)
    if (directory / STAGED).is_dir():
        with _alone(directory):
            _finish(directory)


def _finish(directory: Path) -> None:
    if (directory / STAGED / MANIFEST).is_file():
        _switch(directory, None)


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Let one process at a time replace the files of a folder."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _switch(directory: Path, keep_as: str | None) -> None:
    """Take the staged files in place of those of before; all of it can be repeated."""
    staged, aside = directory / STAGED, directory / SET_ASIDE
    before, now = _listed(directory / MANIFEST), _listed(staged / MANIFEST)
    aside.mkdir(exist_ok=True)
    for name in sorted(before.keys() | now.keys()):
        path = directory / name
        wanted = now.get(name, ABSENT)
        if not os.path.lexists(path) or (wanted != ABSENT and not (staged / name).exists()):
            continue  # nothing in the way, or a call that broke off here has put the new one there
        digest = _digest(path.read_bytes()) if path.is_file() else None
        if digest is not None and digest in (before.get(name), now.get(name)):
            os.replace(path, aside / name)
        elif name in now:
            keep(path)
    for name in now:
        if (staged / name).exists():
            os.replace(staged / name, directory / name)
    os.replace(staged / MANIFEST, directory / MANIFEST)
    shutil.rmtree(staged, ignore_errors=True)
    if keep_as is not None and any(aside.iterdir()):
        os.replace(aside, _free(directory / keep_as))
    shutil.rmtree(aside, ignore_errors=True)


def keep(path: Path) -> Path:
    """Rename a file or folder that is in the way to `NAME.kept`, or `NAME.kept2` and so on."""
    kept = _free(path.with_name(f"{path.name}.kept"))
    os.replace(path, kept)
    return kept


def _free(path: Path) -> Path:
    """Return a path where nothing is: the given one, or with the first number that is free."""
    number, free = 1, path
    while os.path.lexists(free):
        number += 1
        free = path.with_name(f"{path.name}{number}")
    return free


def _listed(manifest: Path) -> dict[str, str]:
    try:
        listed = read_json(manifest)
    except (OSError, ValueError):
        return {}
    if not isinstance(listed, dict):
        return {}
    return {name: str(digest) for name, digest in listed.items() if Path(name).name == name}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@contextmanager
def recreated(directory: Path, name: str) -> Iterator[None]:
    """Remove the sub-folder that the same command made before, and note the one that the block
    makes.

    What a block leaves that ends with Ctrl-C or a failure is the command's, too: the next run
    removes it. All that writes there must have ended with the block.

    Args:
        directory: in which the sub-folder lies.
        name: of it.

    Raises:
        FileExistsError: as `remove_made`, before the block.
    """
    remove_made(directory, name)
    try:
        yield
    finally:
        if (directory / name).exists():
            note_made(directory, name)


def note_made(directory: Path, name: str) -> None:
    """Note what a command made, so that `remove_made` may remove it.

    Args:
        directory: the folder of the note.
        name: of the sub-folder that was made.
    """
    noted = _noted(directory)
    noted[name] = _digests(directory / name)
    write_json(directory / MADE, noted)


def remove_made(directory: Path, name: str) -> None:
    """Remove a sub-folder that a command made before.

    Raises:
        FileExistsError: something of this name is there that was not made so, or that has changed
            since.
    """
    path = directory / name
    if not os.path.lexists(path):
        return
    noted = _noted(directory).get(name)
    if path.is_symlink() or not path.is_dir() or noted is None:
        raise FileExistsError(
            f"{path} is there, and this command did not make it; expected nothing there or what an "
            "earlier run made: remove it yourself, or give another folder with --out"
        )
    found = _digests(path)
    strange = sorted(file for file in found if noted.get(file) != found[file])
    if strange:
        raise FileExistsError(
            f"{path} holds {strange[0]}, which the run before did not leave so; expected what it "
            "made and nothing else: move your own files, or give another folder with --out"
        )
    shutil.rmtree(path)


def _noted(directory: Path) -> dict[str, dict[str, str]]:
    with suppress(OSError, ValueError):
        noted = read_json(directory / MADE)
        if isinstance(noted, dict):
            return {name: files for name, files in noted.items() if isinstance(files, dict)}
    return {}


def _digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder, by relative path; links by their target."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = f"link to {os.readlink(path)}"
        elif path.is_file():
            with path.open("rb") as file:
                found[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return found
