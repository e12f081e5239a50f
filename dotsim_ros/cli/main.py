# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_ros VERB`: finds the verb's file and hands it the rest of the command line.

A verb NAME is the module `dotsim_ros.cli.NAME` (dashes as underscores) with its help in the
docstring, the first line as the summary and the examples last, and a function `run`, whose
keyword-only parameters are the options and which returns the exit status.
"""

from __future__ import annotations

import ast
import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from cyclopts import App, CycloptsError, Parameter

from dotsim_ros.io.printable import cut, did_you_mean, one_line

FAILED = 1
WRONG_CALL = 2
INTERRUPTED, TERMINATED = 130, 143
"""128 and the number of SIGINT or SIGTERM, as shells have it."""
OUTPUT_FOLDERS = ("out", "run_folder", "record", "pictures")
"""Options of the verbs that name folders to write into; `out` may be a sensor's file, too."""
OUTPUT_FILES = ("json", "sensor_out", "fit_optical_noise")
MOVED = {
    "hide": "python -m studies hide",
    "reference": "python -m studies reference_presses",
    **{
        f"evaluate {subject}": f"python -m studies {subject}"
        for subject in (
            "classification",
            "gap",
            "gelsight",
            "gelsight_taxim",
            "geometry",
            "geometry_later",
            "optics",
            "real_cylinders",
            "real_force",
            "real_pair",
            "rl",
            "runtime",
            "trajectory",
            "tumour",
        )
    },
}
"""Commands of earlier releases, and what does the same in a checkout."""
_NOT_VERBS = ("executables", "main")


def verbs() -> dict[str, str]:
    """Return the summary of each verb, by name, without importing any."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("[!_]*.py")):
        if path.stem in _NOT_VERBS:
            continue
        help_text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        found[path.stem.replace("_", "-")] = help_text.partition("\n")[0]
    return found


def _overview() -> str:
    known = verbs()
    width = max(map(len, known))
    listing = "\n".join(f"  {name:<{width}}  {summary}" for name, summary in known.items())
    return (
        "usage: dotsim_ros VERB ...\n\n"
        "Simulated optical tactile sensors: the commands that need no ROS graph.\n\n"
        f"verbs:\n{listing}\n\nexample:\n  dotsim_ros view --help"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a verb.

    Returns:
        The exit status: 0 when done, 1 where the input was bad or a training diverged (with one
        line that says why), 2 for a command of an earlier release, 130 after Ctrl-C, 143 after
        SIGTERM.

    Raises:
        SystemExit: a wrong command line, with 2 and one line; after help, with 0.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    for count in (1, 2):
        if moved := MOVED.get(" ".join(words[:count])):
            print(
                f"dotsim_ros {' '.join(words[:count])}: it is `{moved}` in a checkout of the "
                "source, and no longer installed",
                file=sys.stderr,
            )
            return WRONG_CALL
    verb, *rest = words or [""]
    if verb in ("--help", "-h"):
        print(_overview())
        sys.exit(0)
    if verb not in (known := verbs()):
        near = did_you_mean(verb, known)
        _refuse("", f"{cut(verb, 60)!r} is not a verb{near}; expected one of {', '.join(known)}")
    if "OMP_NUM_THREADS" not in os.environ:
        # For each process that a command starts, and for this one where NumPy is yet to be loaded:
        # `dotsim_ros.io.cores` says why.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        with _ending_on_terminate():
            return _run(verb, rest)
    except _TerminateError:
        print(f"dotsim_ros {verb}: terminated", file=sys.stderr)
        return TERMINATED
    except KeyboardInterrupt:
        print(f"dotsim_ros {verb}: interrupted", file=sys.stderr)
        return INTERRUPTED


def _refuse(verb: str, reason: object) -> NoReturn:
    """End with what is wrong with the command line, on one line whatever it repeats."""
    command = f"dotsim_ros {verb}".rstrip()
    print(f"{command}: error: {one_line(reason)} (usage: {command} --help)", file=sys.stderr)
    sys.exit(WRONG_CALL)


class _TerminateError(KeyboardInterrupt):
    """SIGTERM: what is begun ends as with Ctrl-C, so that nothing of it is left."""


@contextmanager
def _ending_on_terminate() -> Iterator[None]:
    def end(_number: int, _frame: FrameType | None) -> None:
        raise _TerminateError

    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _run(verb: str, rest: Sequence[str]) -> int:
    module = importlib.import_module(f"dotsim_ros.cli.{verb.replace('-', '_')}")
    about, _, examples = (module.__doc__ or "").partition("\nexample:\n")
    app = App(
        name=f"dotsim_ros {verb}",
        help=about,
        help_format="markdown",
        version_flags=(),
        default_parameter=Parameter(consume_multiple=True, negative=(), allow_repeating=True),
    )
    command = app.default(module.run)
    try:
        called, bound, _ = app.parse_args(list(rest), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        _refuse(verb, error)
    if called is not command:
        called(*bound.args, **bound.kwargs)
        print(f"example:\n{examples.rstrip()}")
        sys.exit(0)
    if empty := [name for name, value in bound.arguments.items() if value == ()]:
        _refuse(verb, f"--{empty[0].replace('_', '-')} is given without a value")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A name that the terminal cannot show must not end a command.
        sys.stdout.reconfigure(errors="backslashreplace")
    bound.apply_defaults()
    given = {name: _at_home(value) for name, value in bound.arguments.items()}
    bound.arguments.update(given)
    try:
        _check_outputs(given)
        return int(module.run(*bound.args, **bound.kwargs))
    except (ValueError, OSError, FloatingPointError) as error:
        # One line, whatever stands in the names that it repeats.
        print(f"dotsim_ros {verb}: {one_line(error)}", file=sys.stderr)
        return FAILED


def _at_home(value: Any) -> Any:
    """Put the user's home for a leading `~` of paths: shells leave it in `--out=~/report`."""
    from dotsim_ros.io.files import expanded

    if isinstance(value, tuple):
        return tuple(map(_at_home, value))
    return expanded(value) if isinstance(value, Path) else value


def _check_outputs(given: Mapping[str, Any]) -> None:
    """Try whether what a command will write can be written, before it begins.

    Raises:
        OSError: it cannot; the text names the file or folder.
    """
    from dotsim_ros.io.files import check_output_file, check_output_folder

    for name in (*OUTPUT_FOLDERS, *OUTPUT_FILES):
        if given.get(name) is not None:
            path = Path(given[name])
            is_file = name in OUTPUT_FILES or path.suffix in (".yaml", ".yml")
            (check_output_file if is_file else check_output_folder)(path)


if __name__ == "__main__":
    sys.exit(main())
