# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The state of a training on disk: read without running code, and set aside where it is broken."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import nn

from dotsim_ros.io.replacement import keep

_log = logging.getLogger(__name__)


def read_checkpoint(path: Path, entries: Sequence[str]) -> dict[str, Any]:
    """Return the state of a training.

    Args:
        path: of the file.
        entries: that it must have.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file holds none.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no state of a training at {path}; name a training.pt")
    try:
        return _state(path, entries)
    except ValueError as error:
        raise ValueError(f"{error}; name another file") from error


def _state(path: Path, entries: Sequence[str]) -> dict[str, Any]:
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    # What torch raises on a broken file is not bounded, and its words advise to run code of it.
    except Exception as error:
        raise ValueError(
            f"{path} is no state of a training that can be read ({type(error).__name__}), expected "
            "what an interrupted training left"
        ) from error
    missing = [name for name in entries if not isinstance(state, Mapping) or name not in state]
    if missing:
        raise ValueError(f"{path} is no state of a training: it lacks {', '.join(missing)}")
    return dict(state)


def state_to_resume(path: Path, entries: Sequence[str]) -> dict[str, Any] | None:
    """Return the state that an interrupted training left; None where there is none.

    One that cannot be read is kept under another name, with a line in the log.
    """
    if not path.is_file():
        return None
    try:
        return _state(path, entries)
    except (OSError, ValueError) as error:
        _log.warning("%s; it is kept as %s, and training begins again", error, keep(path).name)
        return None


def take_weights(network: nn.Module, weights: Any, path: Path) -> None:
    """Load weights of a state into a network.

    Raises:
        ValueError: they are those of another one.
    """
    try:
        network.load_state_dict(weights)
    except (RuntimeError, TypeError, AttributeError, KeyError, ValueError) as error:
        raise ValueError(
            f"{path} holds weights of another network, expected those of the one that is trained; "
            "remove it to train again"
        ) from error
