# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that people and programs give: YAML, JSON, tables (.csv) and arrays (.npz), read within
bounds.

Whatever stands in a file, reading it ends soon, takes little memory, executes nothing, and gives
either its content or one line that names the file, what is wrong with it and what was expected.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import numbers
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from dotsim_ros.io.printable import cut, one_line

Arrays = dict[str, np.ndarray[Any, Any]]

LARGEST_YAML_BYTES = 1_000_000
"""Ten thousand trajectories of a data set; PyYAML reads some 100 kB a second."""
LARGEST_YAML_DEPTH = 50
LARGEST_YAML_NODE_COUNT = 200_000
"""Aliases counted as what they stand for: a few lines of nested ones are billions of entries."""
LARGEST_JSON_BYTES = 256_000_000
LARGEST_TABLE_BYTES = 64_000_000
LARGEST_ARRAYS_BYTES = 4_000_000_000
"""Of all arrays of a file together, unpacked."""
LONGEST_EXCERPT = 60


@dataclass(frozen=True)
class ArrayForm:
    """What an array of a file must be.

    Attributes:
        shape: its lengths; None for any.
        kind: "number" (finite), "whole number", "truth value" or "text".
    """

    shape: tuple[int | None, ...]
    kind: str = "number"

    def __str__(self) -> str:
        lengths = ", ".join("any" if n is None else str(n) for n in self.shape)
        return f"{self.kind}s of shape ({lengths})"


_KINDS = {"number": "fiu", "whole number": "iu", "truth value": "b", "text": "U"}


@dataclass(frozen=True)
class Table:
    """A table of texts, one column a name.

    Attributes:
        place: the file.
        columns: the names, each there once.
        rows: as many texts each as there are names.
        lines: the line of the file that each row ends on.
    """

    place: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]

    def texts(self, column: str) -> list[str]:
        """Return the cells of a column.

        Raises:
            ValueError: no such column.
        """
        if column not in self.columns:
            raise ValueError(
                f"{self.place}: no column {column} among {', '.join(self.columns) or 'none'}"
            )
        index = self.columns.index(column)
        return [row[index] for row in self.rows]

    def numbers(self, column: str) -> NDArray[np.float64]:
        """Return a column (N,) of finite numbers.

        Raises:
            ValueError: no such column, or a cell that is no finite number.
        """
        values = []
        for line, text in zip(self.lines, self.texts(column), strict=True):
            if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
                raise ValueError(
                    f"{self.place}, line {line}, column {column}: {value_text(text)} is not a "
                    "number; expected a finite one with a decimal point, without a unit"
                )
            values.append(float(text))
        return np.array(values, dtype=np.float64)


_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?", re.ASCII)


class _BoundedLoader(yaml.SafeLoader):
    """Reads plain data alone, as YAML 1.2 takes `3e5`: for a number; YAML 1.1 takes it for text.

    Refuses a name that is given twice or is no text, and what is nested or repeated beyond bounds.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._node_count: dict[int, int] = {}
        self._node_total = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()
        is_alias = isinstance(event, yaml.AliasEvent)
        if is_alias:
            node = super().compose_node(parent, index)
            if id(node) not in self._node_count:
                raise yaml.MarkedYAMLError(
                    problem=f"*{event.anchor} stands within what it stands for",
                    problem_mark=event.start_mark,
                )
            self._count(self._node_count[id(node)], event)
            return node
        self._depth += 1
        if self._depth > LARGEST_YAML_DEPTH:
            raise yaml.MarkedYAMLError(
                problem=f"nested deeper than {LARGEST_YAML_DEPTH} levels",
                problem_mark=event.start_mark,
            )
        before = self._node_total
        self._count(1, event)
        node = super().compose_node(parent, index)
        self._node_count[id(node)] = self._node_total - before
        self._depth -= 1
        return node

    def _count(self, count: int, event: Any) -> None:
        self._node_total += count
        if self._node_total > LARGEST_YAML_NODE_COUNT:
            raise yaml.MarkedYAMLError(
                problem=f"more than {LARGEST_YAML_NODE_COUNT} entries, aliases counted as what "
                "they stand for",
                problem_mark=event.start_mark,
            )

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                continue
            if key.tag != "tag:yaml.org,2002:str":
                written = key.value if isinstance(key, yaml.ScalarNode) else "a list or mapping"
                raise yaml.MarkedYAMLError(
                    problem=f"{value_text(written)} is no text and so no name; write it in "
                    "quotes if it is meant as one",
                    problem_mark=key.start_mark,
                )
            if key.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"{value_text(key.value)} is given twice", problem_mark=key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_BoundedLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


def _tuple(loader: _BoundedLoader, node: yaml.SequenceNode) -> list[Any]:
    return loader.construct_sequence(node)


# What launch_ros makes of a list of parameters.
_BoundedLoader.add_constructor("tag:yaml.org,2002:python/tuple", _tuple)


def read_yaml(path: str | Path) -> Any:
    """Return what a YAML file holds: mappings by text, lists, texts, numbers, truth values, None.

    Raises:
        FileNotFoundError: no such file.
        OSError: it cannot be opened.
        ValueError: it is no YAML, too large, too deeply nested, or it gives a name twice.
    """
    return parse_yaml(_text_of(Path(path), LARGEST_YAML_BYTES), str(path))


def parse_yaml(text: str, place: str) -> Any:
    """Return what a YAML text holds; as `read_yaml`.

    Args:
        text: YAML.
        place: where it stands, for messages.

    Raises:
        ValueError: as `read_yaml`.
    """
    if len(text) > LARGEST_YAML_BYTES:
        raise ValueError(
            f"{place} holds {len(text)} characters, expected YAML of at most {LARGEST_YAML_BYTES}"
        )
    try:
        loader = _BoundedLoader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = "" if mark is None else f", line {mark.line + 1}, column {mark.column + 1}"
        words = shortened(error.problem or error.context)
        raise ValueError(f"{place} is no valid YAML{line}: {words}") from error
    except yaml.YAMLError as error:
        raise ValueError(f"{place} is no valid YAML: {shortened(error)}") from error
    # The constructors of numbers, dates and tags raise whatever their conversion meets.
    except (ValueError, KeyError, AttributeError, TypeError, IndexError, OverflowError) as error:
        raise ValueError(
            f"{place} holds a value that YAML cannot read: {shortened(error)}"
        ) from error


def read_json(path: str | Path) -> Any:
    """Return what a JSON file holds.

    Raises:
        FileNotFoundError: no such file.
        OSError: it cannot be opened.
        ValueError: it is no JSON, too large or too deeply nested, or it gives a name twice.
    """
    return parse_json(_text_of(Path(path), LARGEST_JSON_BYTES), str(path))


def parse_json(text: str, place: str) -> Any:
    """Return what a JSON text holds; as `read_json`.

    Args:
        text: JSON.
        place: where it stands, for messages.

    Raises:
        ValueError: as `read_json`.
    """
    try:
        return json.loads(text, object_pairs_hook=_mapping_of)
    except RecursionError:
        raise ValueError(f"{place} is no valid JSON: nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"{place} is no valid JSON: {shortened(error)}") from error


def read_table(path: str | Path) -> Table:
    """Return a table of cells that commas divide (RFC 4180), below a line of the columns' names.

    Spaces around a cell are no part of it, and empty lines no rows.

    Raises:
        FileNotFoundError: no such file.
        OSError: it cannot be opened.
        ValueError: it is no text, too large, has a name twice, or a row has not one cell for each
            name; the message says the line.
    """
    reader = csv.reader(io.StringIO(_text_of(Path(path), LARGEST_TABLE_BYTES)), strict=True)
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    try:
        for cells in reader:
            row = tuple(cell.strip() for cell in cells)
            if not any(row):
                continue
            _check_row(row, rows[0] if rows else (), f"{path}, line {reader.line_num}")
            rows.append(row)
            lines.append(reader.line_num)
    except csv.Error as error:
        raise ValueError(f"{path}, line {reader.line_num}: no valid CSV: {error}") from error
    return Table(str(path), rows[0] if rows else (), tuple(rows[1:]), tuple(lines[1:]))


def _check_row(row: tuple[str, ...], columns: tuple[str, ...], place: str) -> None:
    """Refuse a row that has not one cell for each column, or names that are not told apart."""
    if not columns:
        for divider, name in ((";", "semicolons"), ("\t", "tabs")):
            if any(divider in cell for cell in row):
                raise ValueError(
                    f"{place}: {name} divide the names, expected commas, and decimal points in the "
                    "numbers; export the table again so"
                )
        for column, cell in enumerate(row):
            if cell in row[:column]:
                raise ValueError(
                    f"{place}, column {column + 1}: the name {value_text(cell)} is there twice; "
                    "give each column its own"
                )
    elif len(row) != len(columns):
        column = min(len(row), len(columns))
        reason = (
            f"{value_text(row[column])} has no name above it"
            if column < len(row)
            else f"there is no cell under {columns[column]}"
        )
        raise ValueError(
            f"{place}, column {column + 1}: {reason}; the line has {len(row)} cells, expected "
            f"{len(columns)} as there are names. Commas divide cells: numbers need decimal points"
        )


def read_arrays(path: str | Path, forms: Mapping[str, ArrayForm] | None = None) -> Arrays:
    """Return arrays of a .npz file.

    Args:
        path: of the file.
        forms: the arrays that are read, and what they must be; None for all, of any form.

    Raises:
        FileNotFoundError: no such file.
        OSError: it cannot be opened.
        ValueError: it is no .npz file, broken, too large, holds Python objects, lacks an array or
            has it in another form.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no file {path}")
    expected = "expected an .npz file of arrays"
    if forms:
        expected += f" with {', '.join(forms)}"
    try:
        with zipfile.ZipFile(path) as archive:
            members = {
                member.filename.removesuffix(".npy"): member for member in archive.infolist()
            }
            missing = [name for name in forms or () if name not in members]
            if missing:
                raise ValueError(
                    f"{path} has no array {', '.join(missing)}; it holds "
                    f"{value_text(list(members))}"
                )
            wanted = {name: members[name] for name in (members if forms is None else forms)}
            total = sum(member.file_size for member in wanted.values())
            if total > LARGEST_ARRAYS_BYTES:
                raise ValueError(
                    f"{path} would unpack to {total} bytes, expected at most {LARGEST_ARRAYS_BYTES}"
                )
            arrays = {
                name: _array_of(archive, member, f"{path}: {name}")
                for name, member in wanted.items()
            }
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(
            f"{path} is broken or no .npz file ({shortened(error) or 'it ends early'}); {expected}"
        ) from error
    except IsADirectoryError as error:
        raise ValueError(f"{path} is a folder; {expected}") from error
    except OSError as error:
        # One of the file's own names it; of the places within a broken archive none does.
        if error.filename is not None:
            raise
        raise ValueError(f"{path} is broken ({shortened(error)}); {expected}") from error
    for name, form in (forms or {}).items():
        _check_form(arrays[name], form, f"{path}: {name}")
    return arrays


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number, which a truth value is not."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def value_text(value: Any) -> str:
    """Return a value, of any type, as messages show it: in one line, not long, much as in YAML."""
    if value is None or isinstance(value, bool):
        return {None: "empty", True: "true", False: "false"}[value]
    if isinstance(value, list | tuple):
        # What is not shown is not put into words either: a list may have any length.
        words = f"[{', '.join(map(value_text, value[:LONGEST_EXCERPT]))}]"
    elif isinstance(value, dict):
        shown = itertools.islice(value.items(), LONGEST_EXCERPT)
        words = f"{{{', '.join(f'{name}: {value_text(entry)}' for name, entry in shown)}}}"
    elif isinstance(value, str):
        return repr(cut(value, LONGEST_EXCERPT))
    else:
        words = str(value) if isinstance(value, numbers.Real) else repr(value)
    return shortened(words)


def _array_of(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, place: str
) -> np.ndarray[Any, Any]:
    """Read an array after a look at what its header promises."""
    try:
        with archive.open(member) as stream:
            version = npy_format.read_magic(stream)
            read_header = (
                npy_format.read_array_header_1_0
                if version == (1, 0)
                else npy_format.read_array_header_2_0
            )
            shape, _, kind = read_header(stream)
            promised = int(np.prod([kind.itemsize, *shape], dtype=object))
            if kind.hasobject:
                raise ValueError(f"{place} holds Python objects, expected numbers or texts")
            if min(shape, default=0) < 0 or stream.tell() + promised != member.file_size:
                raise ValueError(
                    f"{place} is broken: an array of shape {shape} takes {promised} bytes, it has "
                    f"{member.file_size - stream.tell()}"
                )
        with archive.open(member) as stream:
            return np.asarray(npy_format.read_array(stream, allow_pickle=False))
    # numpy's own words would advise to allow pickles, or to raise its limits.
    except (ValueError, TypeError, SyntaxError, OverflowError, KeyError) as error:
        if str(error).startswith(place):
            raise
        raise ValueError(f"{place} is no array that can be read; write the file again") from error
    except zipfile.zlib.error as error:  # type: ignore[attr-defined]
        raise ValueError(f"{place} is broken ({error}); copy or write the file again") from error


def _check_form(array: np.ndarray[Any, Any], form: ArrayForm, place: str) -> None:
    fits = len(array.shape) == len(form.shape) and all(
        length in (None, there) for length, there in zip(form.shape, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in _KINDS[form.kind]:
        raise ValueError(f"{place} is {array.dtype} of shape {array.shape}, expected {form}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{place} holds a number that is not finite")


def _text_of(path: Path, largest_bytes: int) -> str:
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected a file")
    if not path.exists():
        raise FileNotFoundError(f"no file {path}")
    with path.open("rb") as stream:
        content = stream.read(largest_bytes + 1)
    if len(content) > largest_bytes:
        raise ValueError(f"{path} is larger than the {largest_bytes} bytes that are read")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path} is no text in UTF-8 (byte {error.start} is {content[error.start]:#04x}); save "
            "it as UTF-8"
        ) from error


def _mapping_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{value_text(twice)} is given twice")
    return mapping


def shortened(words: object) -> str:
    """Return what an error says as one line of limited length."""
    return cut(one_line(words), 3 * LONGEST_EXCERPT)
