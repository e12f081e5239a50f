# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fields of frozen data classes that say what they take: unit, range, default and meaning.

A class lists its fields by `quantity`, each with its meaning as a docstring below it, and calls
`check_fields` when it is made, so that a value is checked in one place, whether a file or a program
gives it.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import math
import numbers
import textwrap
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

from dotsim_ros.io.documents import value_text

_KEY = "quantity"

_SLIPS = {"m": (1e-3, "metres"), "Pa": (1e6, "pascals")}
"""What a number in the unit next to ours is multiplied by: millimetres, megapascals."""

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Quantity:
    """What is known of a field next to its default.

    Attributes:
        help: what it is, in one line, where `meanings_of` was asked for it.
        unit: of its numbers; empty for none.
        low, high: smallest and largest number that it takes.
        excludes_low: whether a number must be larger than `low`.
        choices: the texts that it takes; empty for any text.
        is_path: whether a text names a file or folder, in which a leading `~` is the user's home.
        any_length: whether a list may have another length than the default.
        fixed: when it cannot be changed any more, in words; None: as the class says of all fields.
    """

    help: str = ""
    unit: str = ""
    low: float = math.nan
    high: float = math.nan
    excludes_low: bool = False
    choices: tuple[str, ...] = ()
    is_path: bool = False
    any_length: bool = False
    fixed: str | None = None

    @property
    def has_range(self) -> bool:
        """Whether it takes numbers."""
        return not (math.isnan(self.low) or math.isnan(self.high))

    def contains(self, number: float) -> bool:
        """Return whether a number is in the range; one that is not finite is in none."""
        if not math.isfinite(number):
            return False
        return (self.low < number or (self.low == number and not self.excludes_low)) and (
            number <= self.high
        )

    @property
    def range_text(self) -> str:
        """The range of its numbers in words."""
        above = "above " if self.excludes_low else ""
        return f"{above}{number_text(self.low)} to {number_text(self.high)}"


def quantity(default: Any, **known: Any) -> Any:
    """Return a field of a data class; `known` as in `Quantity`.

    Its type is that of the default: true or false, a whole number, a number, a text, or a list of
    texts, or of as many numbers as the default has (of any length where that is empty).

    Raises:
        TypeError: a number without a range, or a type that no field has.
    """
    found = Quantity(**known)
    if not isinstance(default, bool | int | float | str | tuple):
        raise TypeError(f"no field can have the default {default!r}")
    if (isinstance(default, bool | str) or _is_texts(default)) == found.has_range:
        raise TypeError(f"{default!r}: numbers, and only they, need both ends of a range")
    return dataclasses.field(default=default, metadata={_KEY: found})


def _is_texts(default: Any) -> bool:
    return isinstance(default, tuple) and bool(default) and isinstance(default[0], str)


def quantities_of(kind: type) -> dict[str, tuple[Any, Quantity]]:
    """Return default and description of each field of a class, by its name."""
    return {
        field.name: (field.default, field.metadata[_KEY])
        for field in dataclasses.fields(kind)
        if _KEY in field.metadata
    }


@functools.cache
def meanings_of(kind: type) -> dict[str, str]:
    """Return what each field of a class is, in one line: the docstring below it in the source."""
    (declared,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(declared, ast.ClassDef)
    written = {
        ast.unparse(field.target): " ".join(ast.literal_eval(text.value).split())
        for field, text in pairwise(declared.body)
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr)
    }
    return {name: written[name] for name in quantities_of(kind)}


def check_fields(section: str, instance: Any) -> None:
    """Check every field of an instance; a whole number may stand for another, a list for a tuple.

    Args:
        section: that messages name the fields by; empty for none.
        instance: of a class whose fields are by `quantity`; others it leaves alone.

    Raises:
        ValueError: names the field, its value, what it takes, and what may have been meant.
    """
    for name, (default, known) in quantities_of(type(instance)).items():
        called = f"{section}.{name}" if section else name
        value = _checked(called, getattr(instance, name), default, known)
        # Instances are frozen for everyone else.
        object.__setattr__(instance, name, value)


def check_value(kind: type, name: str, value: Any, *, called: str) -> None:
    """Check a value for one field of a class, which the message calls by another name.

    Raises:
        ValueError: as `check_fields`.
    """
    default, known = quantities_of(kind)[name]
    _checked(called, value, default, known)


def section_from(kind: type[Kind], section: str, values: Any) -> Kind:
    """Return a class's instance of a mapping of names to values, as a YAML file holds it.

    Args:
        kind: the class, all fields of which are by `quantity`.
        section: what the mapping is called.
        values: the mapping; None, which YAML makes of an empty section, for all defaults.

    Raises:
        ValueError: it is no mapping, an entry is unknown, or as the class raises it.
    """
    if values is None:
        values = {}
    if not isinstance(values, dict):
        raise ValueError(
            f"section {section!r} is {value_text(values)}, expected names and their values"
        )
    known = quantities_of(kind)
    unknown = sorted(str(name) for name in values if name not in known)
    if unknown:
        raise ValueError(
            f"section {section!r} has unknown entries {unknown}; known are {sorted(known)}"
        )
    return kind(**values)


def field_table(kind: type) -> str:
    """Return the fields of a class as a table in Markdown: name, unit, range, default, meaning."""
    rows = ["| field | unit | range | default | what it is |", "|---|---|---|---|---|"]
    for name, (default, known) in quantities_of(kind).items():
        cells = (f"`{name}`", known.unit, _range_cell(default, known), _default_cell(default))
        rows.append(f"| {' | '.join(cells)} | {meanings_of(kind)[name]} |")
    return "\n".join(rows) + "\n"


def _range_cell(default: Any, known: Quantity) -> str:
    if isinstance(default, bool):
        return "true, false"
    if isinstance(default, str):
        return ", ".join(f"`{choice}`" for choice in known.choices) or "text"
    if _is_texts(default):
        return "list of texts"
    if isinstance(default, tuple):
        return f"{f'{len(default)} numbers' if default else 'list'}, {known.range_text}"
    return f"{'whole, ' if isinstance(default, int) else ''}{known.range_text}"


def _default_cell(default: Any) -> str:
    if isinstance(default, str):
        return f"`{default}`" if default else "empty"
    if isinstance(default, tuple):
        return f"[{', '.join(default if _is_texts(default) else map(number_text, default))}]"
    return value_text(default) if isinstance(default, bool) else number_text(default)


def _checked(name: str, value: Any, default: Any, known: Quantity) -> Any:
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{name} is {value_text(value)}, expected true or false")
        return value
    if isinstance(default, str):
        return _checked_text(name, value, known)
    if _is_texts(default):
        if not isinstance(value, list | tuple) or not all(isinstance(each, str) for each in value):
            raise ValueError(f"{name} is {value_text(value)}, expected a list of texts")
        return tuple(value)
    if isinstance(default, tuple):
        return _checked_list(name, value, default, known)
    noun = "a whole number" if isinstance(default, int) else "a number"
    number = _as_number(value, is_whole=isinstance(default, int))
    if number is None or not known.contains(number):
        raise ValueError(
            f"{name} is {value_text(value)}, expected {noun} from {known.range_text}"
            f"{_unit(known)}{_meant([value], known)}"
        )
    return number


def _checked_text(name: str, value: Any, known: Quantity) -> str:
    if known.choices and value not in known.choices:
        expected = f"one of {', '.join(known.choices)}"
    elif not isinstance(value, str):
        expected = "text"
    else:
        return value
    raise ValueError(f"{name} is {value_text(value)}, expected {expected}")


def _checked_list(
    name: str, value: Any, default: tuple[float, ...], known: Quantity
) -> tuple[float, ...]:
    length = 0 if known.any_length else len(default)
    expected = (
        f"expected {f'{length} numbers' if length else 'a list of numbers'} from "
        f"{known.range_text}{_unit(known)}"
    )
    if not isinstance(value, list | tuple):
        raise ValueError(f"{name} is {value_text(value)}, {expected}")
    if length and len(value) != length:
        raise ValueError(f"{name} is {value_text(value)}, {len(value)} entries, {expected}")
    is_whole = bool(default) and isinstance(default[0], int)
    found = [_as_number(entry, is_whole=is_whole) for entry in value]
    if any(number is None or not known.contains(number) for number in found):
        raise ValueError(f"{name} is {value_text(value)}, {expected}{_meant(value, known)}")
    return tuple(number for number in found if number is not None)


def _as_number(value: Any, *, is_whole: bool) -> float | int | None:
    """Return a number as Python's own, or None where it is none of this type."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    if is_whole:
        return int(value) if isinstance(value, numbers.Integral) else None
    try:
        return float(value)
    except OverflowError:
        return None


def _meant(values: Any, known: Quantity) -> str:
    """Return what may have been meant, as the end of a message."""
    for value in values:
        if isinstance(value, str):
            try:
                number = float(value)
            except ValueError:
                return ""
            if known.contains(number):
                return f"; this is text, the number is written {number_text(number)}"
    found = [_as_number(value, is_whole=False) for value in values]
    if known.unit not in _SLIPS or None in found:
        return ""
    factor, unit = _SLIPS[known.unit]
    scaled = [float(f"{factor * number:.12g}") for number in found if number is not None]
    if not all(map(known.contains, scaled)):
        return ""
    meant = ", ".join(map(number_text, scaled))
    return f"; did you mean {meant if len(scaled) == 1 else f'[{meant}]'} ({unit})?"


def _unit(known: Quantity) -> str:
    return f" {known.unit}" if known.unit else ""


def number_text(number: float) -> str:
    """Return a number as YAML reads it back: 1e-05 would be text there."""
    short = f"{number:g}"
    mantissa, exponent, power = (short if float(short) == number else f"{number:.12g}").partition(
        "e"
    )
    return f"{mantissa}{'' if '.' in mantissa or not exponent else '.0'}{exponent}{power}"
