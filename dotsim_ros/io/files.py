# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that are whole or not there."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import logging
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.documents import value_text
from dotsim_ros.io.printable import did_you_mean

_log = logging.getLogger(__name__)

# colcon build --symlink-install imports a link to the package, without params next to it.
PACKAGE_ROOT = Path(str(files("dotsim_ros"))).resolve()


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that takes the name of `path` when the block ends well.

    The temporary file has the suffix of `path`, from which writers infer the format. An OSError of
    the block names `path`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        no_room_named(path),
        tempfile.TemporaryDirectory(prefix=".part.", dir=path.parent) as folder,
    ):
        temporary = Path(folder) / path.name
        try:
            yield temporary
            os.replace(temporary, path)
        except OSError as error:
            if error.errno is None or error.filename not in (None, str(temporary), temporary):
                raise
            # Else users are told of a name that they never gave, or of none.
            raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def no_room_named(path: Path) -> Iterator[None]:
    """Say in the system's error of a full disk what was to be written."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        raise OSError(
            f"{path} could not be written ({error.strerror}), and what was there before is as it "
            "was; make room, and give the same command again"
        ) from error


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Return an image (H, W, 3), red, green, blue.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it is no image.
    """
    # As in `encoded_image`.
    import cv2

    if not Path(path).is_file():
        raise FileNotFoundError(f"no image {path}")
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError(f"{path} is no image that OpenCV can read; expected a PNG or JPEG file")
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def encoded_image(path: str | Path, image: NDArray[np.uint8]) -> bytes:
    """Return a file's content for an image (H, W, 3), red, green, blue, in the format that the
    suffix names.

    Raises:
        OSError: it could not be encoded.
    """
    # Launch files look for files by this module, in an interpreter that may lack OpenCV.
    import cv2

    is_done, encoded = cv2.imencode(Path(path).suffix, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    if not is_done:
        raise OSError(f"{path} could not be written")
    return bytes(encoded)


def write_image(path: str | Path, image: NDArray[np.uint8]) -> None:
    """Write an image (H, W, 3), red, green, blue, in the format that the suffix names.

    Raises:
        OSError: it could not be written.
    """
    content = encoded_image(path, image)
    with whole_file(path) as part:
        # OpenCV would write it itself, but not say why it could not.
        part.write_bytes(content)


def beside(path: str | Path, ending: str, *, replaces: tuple[str, ...]) -> Path:
    """Return the path of a file that belongs to another and lies next to it.

    Args:
        path: of the other.
        ending: what its name ends with.
        replaces: suffixes that give way to it; all else behind a dot is part of the name, so that
            "press_0.5mm" and "press_0.7mm" do not share their files.
    """
    path = Path(path)
    name = path.stem if path.suffix.lower() in replaces else path.name
    return path.with_name(f"{name}{ending}")


def parameter_path(relative: str) -> Path:
    """Return the path of a file below `params/`, in an installed package or in a source checkout.

    Raises:
        FileNotFoundError: no such file; the message names the folders that were searched.
    """
    candidates = [PACKAGE_ROOT / "params" / relative, PACKAGE_ROOT.parent / "params" / relative]
    for candidate in candidates:
        if candidate.exists():
            return candidate
    searched = ", ".join(str(candidate) for candidate in candidates)
    raise FileNotFoundError(f"no parameter file {relative!r}; searched {searched}")


def shipped_names(folder: str) -> list[str]:
    """Return the names of what lies in a folder below `params/`: its YAML files and folders."""
    there = parameter_path(folder).iterdir()
    return sorted(path.stem for path in there if path.is_dir() or path.suffix == ".yaml")


def shipped_path(folder: str, name: str, kind: str, otherwise: str) -> Path:
    """Return the path of what a user has named in a folder below `params/`.

    Args:
        folder: such as "sensors".
        name: of a YAML file there, without its suffix, or of a folder.
        kind: what it is, for the message.
        otherwise: what could be given in place of a name, for the message.

    Raises:
        FileNotFoundError: there is none; the message lists those that there are.
    """
    names = shipped_names(folder)
    if name in names:
        path = parameter_path(folder) / name
        return path if path.is_dir() else path.with_name(f"{name}.yaml")
    raise FileNotFoundError(
        f"no {kind} is named {value_text(name)}{did_you_mean(name, names)}, expected one of "
        f"{', '.join(names)}, or {otherwise}"
    )


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, figures: Mapping[str, Any]) -> None:
    """Write figures as a JSON file, whole or not at all."""
    write_text(path, json.dumps(figures, indent=2) + "\n")


def cache_directory() -> Path:
    """Return the folder of computed tables and compiled kernels: `$DOTSIM_ROS_CACHE`, else below
    the user's cache, else as `usable_folder`."""
    below = os.environ.get("XDG_CACHE_HOME")
    try:
        default = Path(below) if below else Path.home() / ".cache"
    except RuntimeError:  # a user without a home
        default = None
    return usable_folder("DOTSIM_ROS_CACHE", default and default / "dotsim_ros")


def usable_folder(variable: str, default: Path | None) -> Path:
    """Return a folder to keep files in, which is made: the one that an environment variable names,
    else the default, else one for temporary files.

    The last is logged, and kept in the variable for this process and those that it starts.

    Raises:
        OSError: nothing can be written to the folder for temporary files either.
    """
    named = os.environ.get(variable)
    folder = expanded(named) if named else default
    reason = "this user has no home" if folder is None else _why_not_writable(folder)
    if folder is not None and reason is None:
        return folder
    temporary = _own_temporary_folder()
    _log.warning(
        "nothing can be kept in %s (%s), so that %s serves; set %s to a folder that can be written",
        folder or "~",
        reason,
        temporary,
        variable,
    )
    os.environ[variable] = str(temporary)
    return temporary


def _why_not_writable(folder: Path) -> str | None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error.strerror or str(error)


def _own_temporary_folder() -> Path:
    folder = Path(tempfile.gettempdir()) / f"dotsim_ros-{os.getuid()}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        state = folder.lstat()
        # Compiled code is loaded from there: nobody else may have made it or may write to it.
        is_own = stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid()
        if is_own and not state.st_mode & 0o022 and _why_not_writable(folder) is None:
            return folder
    return Path(tempfile.mkdtemp(prefix="dotsim_ros-"))


def expanded(path: str | Path) -> Path:
    """Return a path in which a leading `~` stands for a user's home, if there is that user."""
    try:
        return Path(path).expanduser()
    except (RuntimeError, ValueError):
        return Path(path)


def given_path(name: str) -> Path:
    """Return the path of a file or folder that a sensor names, absolute or below `params/`."""
    path = expanded(name)
    return path if path.is_absolute() else parameter_path(name)


def short_name(name: str) -> str:
    """Return a name as it is, or where it is longer than 80 bytes its beginning and a hash.

    File systems take 255 bytes, and what is written for a while next to a file needs some of them.
    """
    encoded = os.fsencode(name)
    if len(encoded) <= 80:
        return name
    digest = hashlib.sha256(encoded).hexdigest()[:16]
    return f"{encoded[:63].decode(errors='ignore')}-{digest}"


PROBE_BYTES = 1 << 20
"""What an output folder must have room for before anything long begins."""


def check_output_folder(path: str | Path) -> None:
    """Try whether files can be written into a folder that need not be there yet.

    A file is written into it, or into the nearest folder above that is there, and removed.

    Raises:
        OSError: they cannot; the text says why and what to do.
    """
    path = Path(path)
    there = path.absolute()
    try:
        while not _is_there(there):
            there = there.parent
        if not there.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        with tempfile.NamedTemporaryFile(prefix=".dotsim_ros.", dir=there) as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        reason = f"{there} is no folder" if error.errno == errno.ENOTDIR else error.strerror
        raise OSError(
            f"nothing can be written to {path} ({reason}), expected a folder with room for files; "
            "name another, or make room"
        ) from error


def _is_there(path: Path) -> bool:
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def check_output_file(path: str | Path) -> None:
    """Try whether a file can be written, as `check_output_folder`.

    Raises:
        OSError: it cannot, or a folder has its name.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, expected the name of a file to write")
    check_output_folder(path.parent)
