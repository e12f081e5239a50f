# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A network's graph, run by ONNX Runtime: opened only where it takes and gives what it should."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from dotsim_ros.io.documents import shortened

Shape = tuple[int, ...]


class Network:
    """A graph of one output, all arrays of which are single precision.

    Args:
        graph: the file; its weights lie next to it.
        inputs: shapes of all that can be given, by name; the graph may take fewer.
        output: shape of what it gives.
        thread_count: of the network.
        noun: what messages call it.

    Attributes:
        session: of ONNX Runtime.

    Raises:
        ValueError: it is no graph that can be run, it has other inputs or outputs, or it gives
            numbers that are not finite for arrays of zeros.
    """

    def __init__(
        self,
        graph: Path,
        *,
        inputs: Mapping[str, Shape],
        output: Shape,
        thread_count: int,
        noun: str,
    ) -> None:
        self._graph, self._noun = graph, noun
        self.session = open_session(graph, thread_count, noun)
        found = {entry.name: entry for entry in self.session.get_inputs()}
        expected = {name: list(shape) for name, shape in inputs.items()}
        wrong = {
            name: entry.shape
            for name, entry in found.items()
            if entry.shape != expected.get(name) or entry.type != "tensor(float)"
        }
        if wrong or not found:
            raise self._refusal(f"takes {wrong or 'nothing'}, expected {expected}")
        given = [(entry.shape, entry.type) for entry in self.session.get_outputs()]
        if given != [(list(output), "tensor(float)")]:
            raise self._refusal(f"gives {given}, expected one array of numbers {list(output)}")
        self._inputs = tuple(found)
        zeros = {name: np.zeros(shape, np.float32) for name, shape in inputs.items()}
        try:
            tried = self(zeros)
        # Whatever a graph may meet: ONNX Runtime has no base class for it.
        except Exception as error:
            raise self._refusal(f"cannot be run ({_words(error)})") from error
        if not np.isfinite(tried).all():
            raise self._refusal("gives numbers that are not finite")

    def __call__(self, arrays: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """Return what the network gives for arrays by name; those that it does not take are left.

        Raises:
            Exception: of ONNX Runtime, where it cannot be run.
        """
        given = {name: arrays[name] for name in self._inputs}
        return np.asarray(self.session.run(None, given)[0])

    def _refusal(self, words: str) -> ValueError:
        return ValueError(f"{self._graph} {words}; copy or train the {self._noun} again")


def open_session(graph: Path, thread_count: int, noun: str) -> onnxruntime.InferenceSession:
    """Return ONNX Runtime's session of a graph.

    Raises:
        ValueError: it is no graph, or names weights that are not next to it.
    """
    options: Any = onnxruntime.SessionOptions()
    options.intra_op_num_threads = thread_count
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # A thread that waits for the next frame must not take a core from the simulation.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ValueError(
            f"{graph} is no network that can be opened ({_words(error)}); copy or train the "
            f"{noun} again"
        ) from error


def _words(error: Exception) -> str:
    """Return what ONNX Runtime says, without its codes and the places in its sources."""
    words = re.sub(r"\[ONNXRuntimeError\] : \d+ : \w+ : ", "", str(error))
    return shortened(re.sub(r"/onnxruntime_src/\S+ ", "", words))
