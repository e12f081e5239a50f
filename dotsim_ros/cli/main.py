"""`dotsim_ros VERB`: finds the verb's file and hands it the rest of the command line.

A verb NAME is the module `dotsim_ros.cli.NAME` (dashes as underscores) with a function
`add_arguments(parser)`, a function `run(arguments) -> int`, and its help in the module's docstring,
the first line as the summary.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

FAILED = 1
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


def _overview() -> argparse.ArgumentParser:
    known = verbs()
    width = max(map(len, known), default=0)
    listing = "\n".join(f"  {name:<{width}}  {summary}" for name, summary in known.items())
    parser = argparse.ArgumentParser(
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
        The exit status: 0 when done, 1 where the input was bad (with one line that says why).
        A wrong command line exits with 2, as argparse does.
    """
    chosen = _overview().parse_args(arguments)
    module = importlib.import_module(f"dotsim_ros.cli.{chosen.verb.replace('-', '_')}")
    summary, _, details = (module.__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(
        prog=f"dotsim_ros {chosen.verb}",
        description=summary,
        epilog=details.strip("\n"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    parsed = parser.parse_args(chosen.rest)
    try:
        return int(module.run(parsed))
    except (ValueError, OSError) as error:
        print(f"dotsim_ros {chosen.verb}: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
