"""Files that are whole or not there."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

MANIFEST = ".report_files.json"
"""Names and SHA-256 of the files that a report wrote into its folder."""


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that takes the name of `path` when the block ends well.

    The temporary file has the suffix of `path`, by which writers tell the format.
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
    # Both, until the old ones are gone: a call that is broken off leaves none that nobody knows.
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
    with whole_file(directory / MANIFEST) as part:
        part.write_text(json.dumps(digests, indent=2) + "\n", encoding="utf-8")
