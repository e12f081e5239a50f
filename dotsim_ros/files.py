"""Files that are whole or not there."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PACKAGE_ROOT = Path(str(files("dotsim_ros")))


MANIFEST = ".report_files.json"
"""Names and SHA-256 of the files that a report wrote into its folder."""


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that takes the name of `path` when the block ends well.

    The temporary file has the suffix of `path`, from which writers infer the format.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as folder:
        temporary = Path(folder) / path.name
        yield temporary
        os.replace(temporary, path)


def write_image(path: str | Path, image: NDArray[np.uint8]) -> None:
    """Write an image (H, W, 3), red, green, blue, in the format that the suffix names.

    Raises:
        OSError: it could not be written.
    """
    with whole_file(path) as part:
        if not cv2.imwrite(str(part), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
            raise OSError(f"{path} could not be written")


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


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, figures: Mapping[str, Any]) -> None:
    """Write figures as a JSON file, whole or not at all."""
    write_text(path, json.dumps(figures, indent=2) + "\n")


def cache_directory() -> Path:
    """Return the folder of computed tables: `$DOTSIM_ROS_CACHE`, else below the user's cache."""
    chosen = os.environ.get("DOTSIM_ROS_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "dotsim_ros"


def given_path(name: str) -> Path:
    """Return the path of a file or folder that a sensor names, absolute or below `params/`."""
    path = Path(name)
    return path if path.is_absolute() else parameter_path(name)


def replace_files(directory: str | Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, and remove those of the call before that are not among them.

    A file that has changed since, or that no call wrote, is left alone.

    Args:
        directory: made where it is absent; it keeps what was written in `MANIFEST`.
        files: contents by name.
    """
    directory = Path(directory)
    before = _written_files(directory)
    now = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    # Both, until the old ones are gone: an interrupted call leaves no file that is not listed.
    _write_manifest(directory, before | now)
    for name, content in files.items():
        with whole_file(directory / name) as part:
            part.write_bytes(content)
    for name in before.keys() - now.keys():
        path = directory / name
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == before[name]:
            path.unlink()
    _write_manifest(directory, now)


def _written_files(directory: Path) -> dict[str, str]:
    try:
        listed = json.loads((directory / MANIFEST).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return {}
    if not isinstance(listed, dict):
        return {}
    return {name: str(digest) for name, digest in listed.items() if Path(name).name == name}


def _write_manifest(directory: Path, digests: Mapping[str, str]) -> None:
    write_json(directory / MANIFEST, digests)
