# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write docs/results/index.md, the one page of results, from their JSON files, or check it.

    python -m studies.results_page [--check]

`results_page.yaml` has an entry for each JSON file below docs/results: its title, what it was
judged on, and tables. An entry whose file has not been made yet is not shown. A table has

    figures:  rows of [what, path, format, goal]: one value a row; or
    rows:     [title of the first column, path]: a row for each value there; the title may be null
    columns:  of `rows`: [title, path, format, goal]
    only:     keys of the rows that are shown, with their names (a list or a mapping)
    where:    values that a row has, to be shown
    judged:   keys of the rows that the goals are for (all)

A path names keys with "/" between them; `*` stands for every key. A column's path begins at its
row, or at the file where it begins with "/", with `{}` for the row's key. A format is Python's: of
a mapping it names the keys, of a list the places. A goal is "<= 5", ">= 5" or "25 +- 0.2"; a
mapping is judged by its first value. The last column says which goals are missed.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
PAGE = RESULTS / "index.md"
ENTRIES = Path(__file__).with_suffix(".yaml")
FIELD = re.compile(r"\{([^:}]*)(:[^}]*)?\}")

INTRODUCTION = """# Results

Each figure is a record: it was measured at the commit, on the machine and by the command that stand
below its table, and it is not updated when the code changes. Other pages link here and do not
repeat figures. `python -m studies.results_page` writes this page from the JSON files.

`sensor_a` is a synthetic stand-in for a real sensor: another solver and another renderer made its
recordings, with noise. [What has been shown](../shown.md) says what stands behind each headline;
[how models are compared](../evaluation.md) defines figures, splits and models; the
[glossary](../glossary.md) has the terms. Goals that are missed stand in the last column.
"""


def found(value: Any, path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the values at a path, each with the keys that its stars stand for."""
    if not path:
        yield (), value
        return
    key, _, rest = path.partition("/")
    if key == "*":
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        for name, entry in entries:
            for keys, hit in found(entry, rest):
                yield (str(name), *keys), hit
    elif isinstance(value, dict) and key in value:
        yield from found(value[key], rest)
    elif isinstance(value, list) and key.isdigit() and int(key) < len(value):
        yield from found(value[int(key)], rest)


def shown(value: Any, form: str) -> str:
    """Return a value by its format, or a dash where there is none."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        parts = {name: value[name] for name, _ in FIELD.findall(form)}
        text = "-" if None in parts.values() else form.format(**parts)
    elif isinstance(value, list):
        text = form.format(*value)
    else:
        text = "-" if value is None else form.format(value)
    return re.sub(r"(?<=\d)%", " %", re.sub(r"-(?=0(\.0+)?%)", "", text))


def goal_shown(goal: str, form: str) -> str:
    """Return a goal as its figure is shown: the form up to a second field."""
    field = FIELD.search(form)
    assert field is not None
    unit = form[field.end() :] if len(FIELD.findall(form)) == 1 else ""
    sign, _, number = goal.rpartition(" ")
    if "+-" in sign:
        return f"{sign.replace('+-', '±')} {number}{unit}"
    spec = field[2] or ":g"
    return (
        f"{sign.replace('<=', '≤').replace('>=', '≥')} {shown(float(number), f'{{{spec}}}{unit}')}"
    )


def misses(value: Any, goal: str) -> bool:
    """Return whether a value misses its goal; what was not measured misses none."""
    while isinstance(value, (dict, list)):
        value = next(iter(value.values() if isinstance(value, dict) else value), None)
    sign, _, number = goal.rpartition(" ")
    if value is None:
        return False
    if sign == "<=":
        return bool(value > float(number))
    if sign == ">=":
        return bool(value < float(number))
    return abs(value - float(sign.removesuffix(" +-"))) > float(number)


def table(heads: Sequence[str], forms: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown, with numbers at the right."""
    sides = ["---:" if ":" in form else "---" for form in forms]
    return "\n".join(f"|{'|'.join(cells)}|" for cells in (heads, sides, *rows))


def figures_table(record: Any, figures: Sequence[Sequence[str]], *, is_whole: bool = True) -> str:
    """Return a table with one figure a row: a dash where a record that is not whole has none."""
    rows = []
    for what, path, form, *goals in figures:
        hits = [hit for _, hit in found(record, path)]
        if not hits and not is_whole:
            hits = [None]
        if len(hits) != 1:
            raise ValueError(f"{len(hits)} values at {path}, expected one")
        missed = any(misses(hits[0], goal) for goal in goals)
        asked = "".join(goal_shown(goal, form) for goal in goals)
        rows.append([what, shown(hits[0], form), asked, "missed" if missed else ""])
    if any(len(figure) > 3 for figure in figures):
        return table(["", "figure", "goal", ""], ["", ":", ":", ""], rows)
    return table(["", "figure"], ["", ":"], [row[:2] for row in rows])


def shown_rows(
    record: Any, entry: Mapping[str, Any], *, is_whole: bool = True
) -> dict[tuple[str, ...], str]:
    """Return the keys of the rows that a table shows, with their names."""
    where = entry.get("where", {})
    hits = {
        keys: ", ".join(keys)
        for keys, hit in found(record, entry["rows"][1])
        if all(hit[key] == value for key, value in where.items())
    }
    if "only" not in entry:
        return hits
    only = entry["only"]
    names = only if isinstance(only, dict) else {name: name for name in only}
    keys_of = {name: keys for keys, name in hits.items()}
    return {keys_of[key]: name for key, name in names.items() if is_whole or key in keys_of}


def rows_table(record: Any, entry: Mapping[str, Any], *, is_whole: bool = True) -> str:
    """Return a table with a row for each value at a path."""
    title, path = entry["rows"]
    hits = dict(found(record, path))
    columns = entry["columns"]
    with_goals = any(len(column) > 3 for column in columns)
    unseen, rows = {column[0] for column in columns}, []
    for keys, name in shown_rows(record, entry, is_whole=is_whole).items():
        cells, missed = [] if title is None else [name], []
        judged = ", ".join(keys) in entry.get("judged", [", ".join(keys)])
        for head, place, form, *goals in columns:
            base, way = (
                (record, place[1:].format(*keys)) if place[:1] == "/" else (hits[keys], place)
            )
            values = [value for _, value in found(base, way)]
            cells.append(", ".join(shown(value, form) for value in values) or "-")
            if values or "*" in place:
                unseen.discard(head)
            if judged and any(misses(value, goal) for goal in goals for value in values):
                missed.append(head)
        rows.append([*cells, ", ".join(missed)] if with_goals else cells)
    if unseen and is_whole:
        raise ValueError(f"no row at {path} has {', '.join(sorted(unseen))}")
    heads = [f"{c[0]} ({goal_shown(c[3], c[2])})" if len(c) > 3 else c[0] for c in columns]
    forms = [column[2] for column in columns]
    if title is not None:
        heads, forms = [title, *heads], ["", *forms]
    if with_goals:
        heads, forms = [*heads, "missed"], [*forms, ""]
    return table(heads, forms, rows)


def records_in(value: Any) -> Iterator[Mapping[str, str]]:
    """Yield every part of a result that says at which commit it was made."""
    if isinstance(value, dict):
        if {"commit", "date"} <= value.keys():
            yield value
        value = list(value.values())
    if isinstance(value, list):
        for entry in value:
            yield from records_in(entry)


def origin_of(record: Mapping[str, Any]) -> Mapping[str, str]:
    """Return the part of a record that says where it comes from; older ones have it apart."""
    found: Mapping[str, str] = record.get("provenance") or record.get("origin") or record
    return found


def made_by(record: Mapping[str, Any], file: str) -> str:
    """Return the line that says where a result comes from."""
    main = origin_of(record)
    lines = []
    if record.get("sealed"):
        lines.append("**Judged once**, on data that nobody had seen; it is not made again.")
    lines.append(
        f"Measured at commit {main['commit'][:7]} on {main['machine']}, {main['date'][:10]}, by "
        f"`{main['command']}`: [{file}]({file})."
    )
    others = set()
    for part in records_in(record):
        if part["commit"] != main["commit"]:
            origin = [part["date"][:10], *([part["machine"]] if "machine" in part else [])]
            others.add(f"{part['commit'][:7]} ({', '.join(origin)})")
    if others:
        lines.append(f"Some rows at {', '.join(sorted(others))}.")
    return " ".join(lines)


def tables(record: Any, entry: Mapping[str, Any], *, is_whole: bool = True) -> list[str]:
    """Return the tables of a record; of one that is not whole those that it has rows for.

    Raises:
        ValueError, KeyError: a path is not there.
    """
    return [
        figures_table(record, shape["figures"], is_whole=is_whole)
        if "figures" in shape
        else rows_table(record, shape, is_whole=is_whole)
        for shape in entry["tables"]
        if is_whole or _has_some(record, shape)
    ]


def _has_some(record: Any, shape: Mapping[str, Any]) -> bool:
    """Return whether a record has any figure of a table."""
    if "rows" in shape:
        return bool(shown_rows(record, shape, is_whole=False))
    return any(hit is not None for row in shape["figures"] for _, hit in found(record, row[1]))


def tables_of(file: str, record: Any) -> str:
    """Return the tables of a new record, which need not be whole; the record itself where it has
    none."""
    groups = yaml.safe_load(ENTRIES.read_text(encoding="utf-8"))
    for entry in (entry for entries in groups.values() for entry in entries):
        if entry["file"] == file:
            try:
                return "\n\n".join(tables(record, entry, is_whole=False))
            except (ValueError, KeyError):
                break
    return json.dumps(record, indent=1, default=str)


def section(entry: Mapping[str, Any]) -> str:
    """Return what the page says of a result."""
    file = entry["file"]
    record = json.loads((RESULTS / file).read_text(encoding="utf-8"))
    try:
        shown_tables = tables(record, entry)
    except (ValueError, KeyError) as error:
        raise ValueError(f"{file}: {error}") from error
    parts = [f"### {entry['title']}", entry["note"].strip(), *shown_tables]
    return "\n\n".join([*parts, made_by(record, file)])


def page() -> str:
    """Return the page.

    Raises:
        ValueError: a JSON file without an entry, or a path that is not there.
    """
    groups = yaml.safe_load(ENTRIES.read_text(encoding="utf-8"))
    entered = {entry["file"] for entries in groups.values() for entry in entries}
    there = {path.relative_to(RESULTS).as_posix() for path in RESULTS.rglob("*.json")}
    if without := there - entered:
        raise ValueError(f"{ENTRIES.name} has no entry for {', '.join(sorted(without))}")
    parts = [INTRODUCTION.strip()]
    for group, entries in groups.items():
        made = [entry for entry in entries if entry["file"] in there]
        parts += [f"## {group}", *map(section, made)]
    return "\n\n".join(parts) + "\n"


def main() -> int:
    """Write or check the page; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare only, and write nothing")
    written = page()
    if not parser.parse_args().check:
        PAGE.write_text(written, encoding="utf-8")
    elif not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != written:
        print(f"{PAGE} is not what the results say: run python -m studies.results_page")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
