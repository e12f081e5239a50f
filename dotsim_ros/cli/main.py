# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_ros VERB`: finds the verb's file and hands it the rest of the command line.

A verb NAME is the module `dotsim_ros.cli.NAME` (dashes as underscores) with a function
`add_arguments(parser)`, a function `run(arguments) -> int`, and its help in the module's docstring,
the first line as the summary.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

from dotsim_ros.io.printable import one_line

FAILED = 1
WRONG_CALL = 2
INTERRUPTED, TERMINATED = 130, 143
"""128 and the number of SIGINT or SIGTERM, as shells have it."""
OUTPUT_FOLDERS = ("out", "run", "record", "cache", "images", "pictures")
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


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, whatever stands in the argument that it repeats."""

    def error(self, message: str) -> NoReturn:
        super().error(one_line(message))


def _overview() -> argparse.ArgumentParser:
    known = verbs()
    width = max(map(len, known), default=0)
    listing = "\n".join(f"  {name:<{width}}  {summary}" for name, summary in known.items())
    parser = _Parser(
        prog="dotsim_ros",
        description="Simulated optical tactile sensors: the commands that need no ROS graph.",
        epilog=f"verbs:\n{listing}\n\nexample:\n  dotsim_ros view --help",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("verb", metavar="VERB", choices=list(known), help="what to do")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="its arguments")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a verb.

    Returns:
        The exit status: 0 when done, 1 where the input was bad or a training diverged (with one
        line that says why).
        A wrong command line exits with 2, as argparse does, Ctrl-C with 130, SIGTERM with 143.
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
    chosen = _overview().parse_args(words)
    if "OMP_NUM_THREADS" not in os.environ:
        # For each process that a command starts, and for this one where NumPy is yet to be loaded:
        # `dotsim_ros.io.cores` says why.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        with _ending_on_terminate():
            return _run(chosen.verb, chosen.rest)
    except _TerminateError:
        print(f"dotsim_ros {chosen.verb}: terminated", file=sys.stderr)
        return TERMINATED
    except KeyboardInterrupt:
        print(f"dotsim_ros {chosen.verb}: interrupted", file=sys.stderr)
        return INTERRUPTED


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
    summary, _, details = (module.__doc__ or "").partition("\n")
    parser = _Parser(
        prog=f"dotsim_ros {verb}",
        description=summary,
        epilog=details.strip("\n"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    parsed = parser.parse_args(rest)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A name that the terminal cannot show must not end a command.
        sys.stdout.reconfigure(errors="backslashreplace")
    _expand_homes(parsed)
    try:
        _check_outputs(parsed)
        return int(module.run(parsed))
    except (ValueError, OSError, FloatingPointError) as error:
        # One line, whatever stands in the names that it repeats.
        print(f"dotsim_ros {verb}: {one_line(error)}", file=sys.stderr)
        return FAILED


def _expand_homes(parsed: argparse.Namespace) -> None:
    """Put the user's home for a leading `~` of paths: shells leave it in `--out=~/report`."""
    from dotsim_ros.io.files import expanded

    for name, value in vars(parsed).items():
        if isinstance(value, Path):
            setattr(parsed, name, expanded(value))
        elif isinstance(value, list):
            setattr(parsed, name, [expanded(v) if isinstance(v, Path) else v for v in value])


def _check_outputs(parsed: argparse.Namespace) -> None:
    """Try whether what a command will write can be written, before it begins.

    Raises:
        OSError: it cannot; the text names the file or folder.
    """
    given = {name: path for name, path in vars(parsed).items() if isinstance(path, Path)}
    for name in (*OUTPUT_FOLDERS, *OUTPUT_FILES):
        if name not in given:
            continue
        from dotsim_ros.io.files import check_output_file, check_output_folder

        is_file = name in OUTPUT_FILES or given[name].suffix in (".yaml", ".yml")
        (check_output_file if is_file else check_output_folder)(given[name])


if __name__ == "__main__":
    sys.exit(main())
