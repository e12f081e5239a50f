# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tell where the figures in docs/results come from, and which are older than what they measure.

    python .ci/results_status.py --markdown docs/results/status.md --mark
    python .ci/results_status.py --markdown docs/results/status.md --check

The first lists every result, writes the page and marks what README.md and docs/ show; the second
only compares, for CI. Both exit with 1 where a figure has no commit, comes from a tree with
uncommitted changes, or says no command that is known, and in a clone without its whole history.

A result is every JSON file below docs/results. Its provenance stands at its top, under
`provenance` or `origin`, and in rows that were made in other runs.

A result is older than the code where that code is not what it was at the result's commit. What
counts as its code is told in measured_code.py, what counts as a change in
dotsim_ros/code_version.py. Older results are no error. Data that were judged before anyone had seen
them cannot be unseen again: docs/results/first_sight.yaml names such results, each with its reason
and with the result of the same data that is made anew as code changes. They stay as they are.

README.md and the pages of docs/ show figures beside a link to their result, its JSON file or its
page. Behind the link to a result that is not current stands a mark, "(measured at commit ...)";
`--mark` puts it there and takes it away again. Links to results are written in place, not as
references or HTML, which could not be marked.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import yaml
from measured_code import Checkout

RESULTS = Path("docs/results")
FIRST_SIGHT = "first_sight.yaml"
STATUS_PAGE = "status.md"
INDEX_PAGE = "index.md"
NONE = "none"
_COMMIT = re.compile(r"(?:.*-g)?(?P<hash>[0-9a-f]{7,40})(?P<dirty>-dirty)?")
_LINK = re.compile(
    r"""(?P<link>\]\(\s*<?(?P<target>[^()<>\s]+)>?(?:\s+["'][^"']*["'])?\s*\))"""
    r"(?P<mark> \(measured at (?:an unrecorded )?commit[^()]*\))?"
)
_OTHER_LINK = re.compile(
    r"""^\s*\[[^\]]+\]:\s*<?(?P<reference>[^<>\s]+)|href=["'](?P<html>[^"']+)"""
)
_SHOWN_DIGITS = 7
_SHOWN_FILES = 3


class State(Enum):
    """How a figure stands to the code of today; the last one is the worst."""

    CURRENT = "current"
    FIRST_SIGHT = "record of first sight"
    OLDER = "older than the code"
    UNKNOWN = "older: unknown commit"
    REFUSED = "error"


@dataclass(frozen=True)
class Origin:
    """Where figures of one file come from.

    Attributes:
        part: which figures; "" for all that say nothing else.
        commit: as recorded; "none" for none.
        date: as recorded.
        command: as recorded; "" for none.
    """

    part: str
    commit: str
    date: str
    command: str

    @property
    def is_clean(self) -> bool:
        """Return whether it names a commit, and no changes on top of it."""
        found = _COMMIT.fullmatch(self.commit)
        return found is not None and not found["dirty"]

    @property
    def hash(self) -> str:
        """Return the commit's own digits, as many as were recorded; "" for none."""
        found = _COMMIT.fullmatch(self.commit)
        return found["hash"] if found else ""


@dataclass(frozen=True)
class FirstSight:
    """Why a result is not made anew.

    Attributes:
        again: the result of the same data under the code of today, below docs/results.
        reason: in a sentence.
    """

    again: Path
    reason: str


@dataclass(frozen=True)
class Result:
    """A file of figures.

    Attributes:
        file: path below docs/results.
        shown_by: the page of its figures, or the file itself where there is none.
        origins: of its figures, and the state of each.
    """

    file: Path
    shown_by: Path
    origins: tuple[tuple[Origin, State], ...]

    @property
    def state(self) -> State:
        """Return the worst state of its figures."""
        order = list(State)
        return max((state for _, state in self.origins), key=order.index)

    @property
    def worst(self) -> list[Origin]:
        """Return the origins that have this state, the latest last."""
        worst = [origin for origin, state in self.origins if state is self.state]
        return sorted(worst, key=lambda origin: origin.date)

    @property
    def last(self) -> Origin:
        """Return the origin of the latest figures."""
        return max((origin for origin, _ in self.origins), key=lambda origin: origin.date)

    @property
    def commits(self) -> list[str]:
        """Return all commits as recorded, the earliest first."""
        ordered = sorted(self.origins, key=lambda pair: pair[0].date)
        return list(dict.fromkeys(origin.commit for origin, _ in ordered))

    @property
    def mark(self) -> str:
        """Return what stands behind a link to it, with a space before; "" where it is current."""
        if self.state is State.CURRENT:
            return ""
        worst = self.worst
        shown = worst[-1]
        if not shown.hash:
            return " (measured at an unrecorded commit)"
        why = {
            State.FIRST_SIGHT: "judged once, before later changes",
            State.OLDER: "before later changes",
            State.UNKNOWN: "not in this history",
        }.get(self.state, "with uncommitted changes")
        others = len(self.commits) - 1
        among = f" and {others} other{'s' if others > 1 else ''}" if others else ""
        some = "some " if len(worst) < len(self.origins) else ""
        return f" (measured at commit {shown.hash[:_SHOWN_DIGITS]}{among}, {some}{why})"


def origins_of(figures: Any) -> list[Origin]:
    """Return where the figures of a file come from, that of the file itself first."""
    top = {}
    if isinstance(figures, dict):
        candidates = (figures, figures.get("provenance"), figures.get("origin"))
        top = next((c for c in candidates if isinstance(c, dict) and "commit" in c), {})
    found = [
        Origin(
            # `origin_OF_SOMETHING` beside it is the origin of that.
            ".".join(k.removeprefix("origin_") for k in keys if k not in ("provenance", "origin")),
            str(record["commit"]) if _COMMIT.fullmatch(str(record["commit"])) else NONE,
            str(record.get("date", top.get("date", ""))),
            str(record.get("command", top.get("command", ""))),
        )
        for keys, record in _records(figures, ())
    ]
    return sorted(found, key=lambda origin: origin.part != "") or [Origin("", NONE, "", "")]


def _records(value: Any, keys: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    if isinstance(value, dict):
        if "commit" in value:
            yield keys, value
        for key, inner in value.items():
            yield from _records(inner, (*keys, str(key)))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _records(inner, (*keys, str(index)))


@dataclass(frozen=True)
class Judged:
    """All results and what is said of some.

    Attributes:
        results: of all files.
        first_sight: by file.
        problems: what is wrong.
    """

    results: list[Result]
    first_sight: dict[Path, FirstSight]
    problems: list[str]


def read_results(checkout: Checkout) -> Judged:
    """Judge every result."""
    folder = checkout.root / RESULTS
    once, problems = _records_of_first_sight(folder)
    results = []
    for path in sorted(folder.rglob("*.json")):
        file = path.relative_to(folder)
        try:
            origins = origins_of(json.loads(path.read_text(encoding="utf-8")))
        except ValueError as error:
            problems.append(f"{RESULTS / file} cannot be read: {error}")
            continue
        judged = []
        wrong: dict[str, list[str]] = {}
        for origin in origins:
            state, problem = _judge(origin, checkout)
            if state is State.OLDER and file in once:
                state = State.FIRST_SIGHT
            judged.append((origin, state))
            if problem:
                wrong.setdefault(problem, []).append(origin.part or "the file itself")
        problems += [
            f"{RESULTS / file}: {problem} ({', '.join(parts)})" for problem, parts in wrong.items()
        ]
        page = path.with_suffix(".md")
        shown_by = page if page.is_file() else path
        results.append(Result(file, shown_by.relative_to(folder), tuple(judged)))
    present = {result.file for result in results}
    problems += [
        f"{RESULTS / FIRST_SIGHT}: there is no {name}, which {file} names"
        for file, record in sorted(once.items())
        for name in (file, record.again)
        if name not in present
    ]
    for page in sorted(folder.rglob("*.md")):
        has_figures = page not in (folder / STATUS_PAGE, folder / INDEX_PAGE)
        if has_figures and not page.with_suffix(".json").is_file():
            problems.append(
                f"{page.relative_to(checkout.root)}: no JSON file beside it says where its figures "
                "come from"
            )
    return Judged(results, once, problems)


def _records_of_first_sight(folder: Path) -> tuple[dict[Path, FirstSight], list[str]]:
    """Return what is said of each result that is not made anew, and what is wrong."""
    path = folder / FIRST_SIGHT
    if not path.is_file():
        return {}, []
    records = {}
    problems = []
    for file, entry in (yaml.safe_load(path.read_text(encoding="utf-8")) or {}).items():
        match entry:
            case {"again": str(again), "reason": str(reason)} if reason.strip() and again != file:
                records[Path(file)] = FirstSight(Path(again), " ".join(reason.split()))
            case _:
                problems.append(
                    f"{RESULTS / FIRST_SIGHT}: {file} needs `again`, the result of the same data "
                    "that is made anew, and a `reason`"
                )
    return records, problems


def _judge(origin: Origin, checkout: Checkout) -> tuple[State, str]:
    """Return the state of figures, and what is wrong with them; "" for nothing."""
    if not origin.is_clean:
        if origin.commit == NONE:
            return State.REFUSED, "no commit is recorded; measure it anew in a checkout"
        return State.REFUSED, (
            f"measured at {origin.commit}, with uncommitted changes: commit them, measure it anew"
        )
    try:
        now = checkout.digest_behind(origin.command)
    except (ValueError, FileNotFoundError) as error:
        return State.REFUSED, f"the code that makes it is not found: {error}"
    if not checkout.is_known(origin.hash):
        return State.UNKNOWN, ""
    try:
        then = checkout.digest_behind(origin.command, origin.hash)
    except (ValueError, FileNotFoundError):
        return State.OLDER, ""
    return (State.CURRENT if now == then else State.OLDER), ""


def table(results: Sequence[Result]) -> str:
    """Return one line a result: name, commit, date, state, command."""
    head = ("result", "commit", "date", "state", "command")
    rows = [
        (str(r.file), _commits(r), r.last.date[:10] or "-", r.state.value, r.last.command or "-")
        for r in results
    ]
    widths = [max(map(len, column)) for column in list(zip(head, *rows, strict=True))[:-1]]
    return "\n".join(
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]])
        for row in (head, *rows)
    )


def _commits(result: Result) -> str:
    others = len(result.commits) - 1
    return result.last.commit + (f" and {others} more" if others else "")


def page_of(judged: Judged, checkout: Checkout) -> str:
    """Return the page of all results, for the documentation."""
    results = judged.results
    counts = Counter(result.state for result in results)
    parts = [
        "# State of the results",
        "Written by `make results-status`; CI checks that it is up to date. Every result records "
        "the commit, the date and the command that it was made with. It is *current* if the code "
        "behind the command, the script and all Python files of this package that it imports, is "
        "the same now as at that commit; comments, docstrings and the places of files do not "
        "count. Data files and other libraries are not compared. A *record of first sight* judged "
        "data that no one had seen, which cannot be done twice. An *unknown commit* is not part "
        "of the published history. Where README.md or a page of the documentation links to a "
        "result that is not current, it says so behind the link.",
        "; ".join(f"{counts[state]} {state.value}" for state in State if counts[state]) + ".",
    ]
    rows = [
        (_linked(r), f"`{_commits(r)}`", r.last.date[:10], r.state.value, _code(r.last.command))
        for r in results
    ]
    parts.append(_table(("result", "commit", "date", "state", "command"), rows))
    by_file = {result.file: result for result in results}
    several = [result for result in results if len(result.commits) > 1]
    if several:
        parts += [
            "## Results of several runs",
            "Rows that were made before are kept beside new ones; each has its own commit.",
            _table(
                ("result", "commit", "state", "figures"),
                [row for result in several for row in _rows_by_commit(result)],
            ),
        ]
    older = [result for result in results if result.state is State.OLDER]
    if older:
        parts += [
            "## Older: what has changed since",
            "Files behind the command that are not what they were at the commit, that of the "
            "latest figures that are older. Paths within `dotsim_ros/` stand without it.",
            _table(
                ("result", "commit", "files"),
                [
                    (_linked(r), f"`{r.worst[-1].commit}`", _changes(r.worst[-1], checkout))
                    for r in older
                ],
            ),
        ]
    if judged.first_sight:
        parts += [
            "## Records of first sight",
            "Data that no one had seen were judged, by the code of that time. What is made anew as "
            "code changes stands beside each, on the same data, which are known by then.",
            _table(
                ("result", "the same data anew", "why it stays"),
                [
                    (_linked(by_file[file]), _linked(by_file[record.again]), record.reason)
                    for file, record in sorted(judged.first_sight.items())
                    if file in by_file and record.again in by_file
                ],
            ),
        ]
    return "\n\n".join(parts) + "\n"


def _changes(origin: Origin, checkout: Checkout) -> str:
    """Return which files have changed since figures were made, the first few by name."""
    try:
        files = checkout.changed_since(origin.command, origin.hash)
    except (ValueError, FileNotFoundError):
        return "what the command runs was not there"
    names = [f"`{file.removeprefix('dotsim_ros/')}`" for file in files[:_SHOWN_FILES]]
    others = len(files) - len(names)
    more = [f"and {others} more"] if others else []
    return ", ".join([*names, *more]) or "only where some names are taken from"


def _rows_by_commit(result: Result) -> list[tuple[str, ...]]:
    parts: dict[tuple[str, State], list[str]] = {}
    for origin, state in sorted(result.origins, key=lambda pair: pair[0].date):
        parts.setdefault((origin.commit, state), []).append(origin.part or "the rest")
    return [
        (_linked(result), f"`{commit}`", state.value, ", ".join(names))
        for (commit, state), names in parts.items()
    ]


def _linked(result: Result) -> str:
    return f"[{result.file.with_suffix('').as_posix()}]({result.shown_by.as_posix()})"


def _code(text: str) -> str:
    return f"`{text}`" if text else "-"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(c.replace("|", "\\|") for c in line) + " |" for line in lines
    )


def marked(text: str, folder: Path, results: Sequence[Result]) -> str:
    """Return a page with a mark behind each link to a result that is not current, and no other.

    Args:
        text: of the page.
        folder: in which the page lies, from the top of the checkout.
        results: of all files.
    """
    by_target = _by_target(results)

    def with_mark(found: re.Match[str]) -> str:
        result = by_target.get(_target(folder, found["target"]))
        return found[0] if result is None else found["link"] + result.mark

    return "\n".join(
        line if is_code else _LINK.sub(with_mark, line) for line, is_code in _lines(text)
    )


def cannot_be_marked(text: str, folder: Path, results: Sequence[Result]) -> list[int]:
    """Return the numbers of lines that link to a result in another way than in place."""
    by_target = _by_target(results)
    return [
        number
        for number, (line, is_code) in enumerate(_lines(text), 1)
        for found in _OTHER_LINK.finditer(line)
        if not is_code and _target(folder, found["reference"] or found["html"]) in by_target
    ]


def _by_target(results: Sequence[Result]) -> dict[str, Result]:
    """Return the results by what a link to one of them leads to."""
    return {
        (RESULTS / result.file).with_suffix(suffix).as_posix(): result
        for result in results
        for suffix in (".json", ".md")
    }


def _target(folder: Path, link: str) -> str:
    """Return the path that a link on a page in a folder leads to, from the checkout's top."""
    return os.path.normpath(folder / link.partition("#")[0]).replace(os.sep, "/")


def _lines(text: str) -> Iterator[tuple[str, bool]]:
    """Yield each line, and whether it is code."""
    is_code = False
    for line in text.split("\n"):
        is_code ^= line.lstrip().startswith("```")
        yield line, is_code


def pages(root: Path) -> list[Path]:
    """Return README.md and the pages of docs/, without those of the results themselves."""
    found = [root / "README.md", *sorted((root / "docs").rglob("*.md"))]
    return [p for p in found if p.is_file() and root / RESULTS not in p.parents]


def main(arguments: Sequence[str] | None = None) -> int:
    """List the results; write or compare what is made from them."""
    summary, _, details = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=details, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    root = Path(__file__).resolve().parent.parent
    parser.add_argument("--root", type=Path, default=root, help="the checkout (this one)")
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="write the page of all results"
    )
    parser.add_argument("--mark", action="store_true", help="mark README.md and the pages of docs/")
    parser.add_argument("--check", action="store_true", help="compare only, and write nothing")
    given = parser.parse_args(arguments)
    checkout = Checkout(given.root)
    judged = read_results(checkout)
    problems = list(judged.problems)
    print(table(judged.results))
    _print_listed(judged)
    if not checkout.has_whole_history():
        partial = (
            "this is no clone with its whole history: commits are unknown, so the page and the "
            "marks were neither compared nor written; run git fetch --unshallow, in a workflow "
            "check out with fetch-depth: 0"
        )
        if given.check or given.mark:
            problems.append(partial)
        else:
            print(f"\nNote: {partial}")
    elif given.check:
        problems += _not_up_to_date(checkout, judged, given.markdown)
    else:
        _write(checkout, judged, given.markdown, given.mark)
    if problems:
        print("\nErrors:", *problems, sep="\n  ")
    return 1 if problems else 0


def _print_listed(judged: Judged) -> None:
    for state in list(State)[1:-1]:
        names = [str(result.file) for result in judged.results if result.state is state]
        if names:
            print(f"\n{state.value.upper()}: {', '.join(names)}")


def _write(checkout: Checkout, judged: Judged, status_page: Path | None, with_marks: bool) -> None:
    if status_page is not None:
        status_page.write_text(page_of(judged, checkout), encoding="utf-8")
    for page in pages(checkout.root) if with_marks else ():
        before = page.read_text(encoding="utf-8")
        after = marked(before, page.parent.relative_to(checkout.root), judged.results)
        if after != before:
            page.write_text(after, encoding="utf-8")


def _not_up_to_date(checkout: Checkout, judged: Judged, status_page: Path | None) -> list[str]:
    root, results, problems = checkout.root, judged.results, []
    if status_page is not None:
        before = status_page.read_text(encoding="utf-8") if status_page.is_file() else ""
        if before != page_of(judged, checkout):
            problems.append(f"{status_page} is not up to date: run `make results-status`")
    for page in pages(root):
        text, folder = page.read_text(encoding="utf-8"), page.parent.relative_to(root)
        pairs = zip(text.split("\n"), marked(text, folder, results).split("\n"), strict=True)
        problems += [
            f"{page.relative_to(root)}:{number}: expected {_marks(is_right)}, found "
            f"{_marks(is_there)}: run `make results-status`"
            for number, (is_there, is_right) in enumerate(pairs, 1)
            if is_there != is_right
        ]
        problems += [
            f"{page.relative_to(root)}:{number}: write the link to a result as [text](path), which "
            "can be marked"
            for number in cannot_be_marked(text, folder, results)
        ]
    return problems


def _marks(line: str) -> str:
    found = [m["link"][2:-1] + (m["mark"] or " without a mark") for m in _LINK.finditer(line)]
    return ", ".join(found)


if __name__ == "__main__":
    sys.exit(main())
