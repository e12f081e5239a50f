# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a process does when, in Chrome's trace event format, which https://ui.perfetto.dev opens.

A process writes one trace at most. Without one a span costs a look at a variable.
"""

from __future__ import annotations

import gc
import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

LARGEST_BYTES = 200_000_000
"""Of a file, some hours of a node; what comes later is left out."""
COLLECTION = "garbage collection"


class Trace:
    """A trace that is being written; use `begin`, `span`, `add` and `end`.

    The format does without the list's end, so that what a killed process leaves can be opened.
    """

    def __init__(self, path: Path, process: str) -> None:
        self._file = path.open("w", encoding="utf-8")
        self._lock = threading.Lock()
        self._threads: set[int] = set()
        self._bytes = 0
        self._collected_s = 0.0
        self.failure: OSError | None = None
        self._write("[\n")
        self._event(ph="M", name="process_name", args={"name": process})
        gc.callbacks.append(self._on_collection)

    def add(self, name: str, begun_s: float, ended_s: float, cpu_s: float | None = None) -> None:
        """Write what this thread did between two readings of `time.perf_counter`, and how long it
        had a core meanwhile, where that is known."""
        thread = threading.get_ident()
        if thread not in self._threads:
            self._threads.add(thread)
            named = {"name": threading.current_thread().name}
            self._event(ph="M", name="thread_name", tid=thread, args=named)
        event = {"name": name, "tid": thread, "ts": 1e6 * begun_s, "dur": 1e6 * (ended_s - begun_s)}
        self._event(ph="X", **event, **({} if cpu_s is None else {"tdur": 1e6 * cpu_s}))

    def _event(self, **event: Any) -> None:
        self._write(json.dumps({"pid": os.getpid(), **event}) + ",\n")

    def _write(self, text: str) -> None:
        with self._lock:
            self._bytes += len(text)
            if self.failure is not None or self._bytes > LARGEST_BYTES:
                return
            try:
                self._file.write(text)
            except OSError as error:
                # Nothing that the process is for waits for its trace.
                self.failure = error

    def _on_collection(self, phase: str, _info: dict[str, int]) -> None:
        if phase == "start":
            self._collected_s = time.perf_counter()
        elif not self._lock.locked():
            # A collection may begin while this thread writes.
            self.add(COLLECTION, self._collected_s, time.perf_counter())

    def close(self) -> None:
        """Write what is left."""
        gc.callbacks.remove(self._on_collection)
        with self._lock:
            try:
                self._file.close()
            except OSError as error:
                self.failure = error


_trace: Trace | None = None
_NOTHING = nullcontext()


def begin(path: str | Path, process: str) -> bool:
    """Begin the process's trace; return whether there was none.

    Args:
        path: of the file; one that is there is replaced.
        process: its name in the trace.

    Raises:
        OSError: the file cannot be written.
    """
    global _trace
    if _trace is not None:
        return False
    _trace = Trace(Path(path), process)
    return True


def end() -> OSError | None:
    """End the process's trace; return why it is not whole, None where it is."""
    global _trace
    ended, _trace = _trace, None
    if ended is None:
        return None
    ended.close()
    return ended.failure


def span(name: str) -> AbstractContextManager[None]:
    """Trace what is done within the context, under a name."""
    return _NOTHING if _trace is None else _span(_trace, name)


def add(name: str, begun_s: float) -> None:
    """Trace what this thread has done since a reading of `time.perf_counter`."""
    if _trace is not None:
        _trace.add(name, begun_s, time.perf_counter())


@contextmanager
def _span(trace: Trace, name: str) -> Iterator[None]:
    begun_s, core_s = time.perf_counter(), time.thread_time()
    try:
        yield
    finally:
        trace.add(name, begun_s, time.perf_counter(), time.thread_time() - core_s)
