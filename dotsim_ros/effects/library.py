# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the effects: those shipped, and files that a user drops into a folder.

A file of a folder is a program, run with the rights of who starts the command. Only what is asked
for is run, once, and its path is logged before.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import inspect
import logging
import pkgutil
import sys
from collections.abc import Callable, Collection, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

from dotsim_ros.effects import builtin
from dotsim_ros.effects.effect import FORCE, IMAGE, SKIN, Effect, EffectParameter
from dotsim_ros.io.printable import one_line

_log = logging.getLogger(__name__)

Announce = Callable[[str], None]

HOOKS = {"gel": 3, "motion": 1, "response": 1, "image": 1}
"""The hooks of an effect, and how many arguments each is given."""
FILTERS = {"motion": 3, "response": 1, "image": 1}
"""The hooks that return a filter, and how many arguments that is given."""
_executed: dict[tuple[Path, str], ModuleType] = {}
"""By the file's path and content."""


def load_effects(
    folders: Sequence[str | Path] = (),
    *,
    names: Collection[str] | None = None,
    announce: Announce | None = None,
) -> dict[str, Effect]:
    """Return every effect by name; those of a user's folder are run as programs.

    Args:
        folders: of files that each hold an `EFFECT`; one of a shipped effect's name replaces it.
            Files whose names begin with an underscore are not effects.
        names: of the effects that are needed: no other file of the folders is run, and none of
            those is returned; None for all that the folders hold.
        announce: called with a line before code of the folders is run; None for the log.

    Raises:
        FileNotFoundError: no such folder.
        ValueError: a file that cannot be run, or that holds no effect of its own name.
    """
    found = dict(_shipped())
    paths = [path for path in _files_of(folders) if names is None or path.stem in names]
    contents = {path: _read(path) for path in paths}
    new = [path for path in paths if (path, _digest(contents[path])) not in _executed]
    for path in new:
        # A folder that was named by mistake must not be run.
        _check_source(path, contents[path])
    if new:
        listed = ", ".join(map(str, new))
        (announce or _log.warning)(one_line(f"runs the code of effects of your own: {listed}"))
    for path in paths:
        module = _run(path, contents[path])
        found[path.stem] = _effect_of(module, path.stem, str(path))
    return found


def effect_names(folders: Sequence[str | Path] = ()) -> tuple[str, ...]:
    """Return the names of all effects, shipped and in folders, without running any file of these.

    Raises:
        FileNotFoundError: no such folder.
    """
    own = [path.stem for path in _files_of(folders)]
    return tuple(dict.fromkeys([*_shipped(), *own]))


@cache
def _shipped() -> dict[str, Effect]:
    """Return the effects of the library by name, in alphabetical order."""
    found = {}
    for info in pkgutil.iter_modules(builtin.__path__):
        module = importlib.import_module(f"{builtin.__name__}.{info.name}")
        for effect in filter(lambda each: isinstance(each, Effect), vars(module).values()):
            found[effect.name] = effect
    return dict(sorted(found.items()))


def _files_of(folders: Sequence[str | Path]) -> list[Path]:
    found = []
    for given in folders:
        folder = Path(given)
        if not str(given).strip():
            raise FileNotFoundError("the folder of effects is empty text; name one, or none at all")
        if not folder.is_dir():
            raise FileNotFoundError(f"no folder of effects at {folder}")
        found += [path for path in sorted(folder.resolve().glob("*.py")) if path.name[0] != "_"]
    return found


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}; expected a file") from error


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _run(path: Path, content: bytes) -> ModuleType:
    """Return the module of a file, run where it was not before."""
    key = path, _digest(content)
    if key in _executed:
        return _executed[key]
    name = f"dotsim_ros_effect_{path.stem}_{key[1][:12]}"
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    # Data classes look up the module that they are defined in.
    sys.modules[name] = module
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)
    # A file that is imported must not end the command that imports it.
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ValueError(
            f"{path} cannot be run: {type(error).__name__}: {one_line(error)}; expected a program "
            "that only defines an EFFECT: mend it, or move it out of the folder"
        ) from error
    except BaseException:
        del sys.modules[name]
        raise
    _executed[key] = module
    return module


def _check_source(path: Path, content: bytes) -> None:
    """Look at a file without running it.

    Raises:
        ValueError: it is not a program, or binds no EFFECT.
    """
    try:
        tree = ast.parse(importlib.util.decode_source(content), str(path))
    # What a hostile file makes of the parser, too: NUL bytes, and nesting without end.
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        number = getattr(error, "lineno", None)
        line = "" if number is None else f", line {number}"
        raise ValueError(
            f"{path} is no Python{line}: {one_line(getattr(error, 'msg', error))}; expected a "
            "program in UTF-8 that holds an EFFECT: mend it, or move it out of the folder"
        ) from error
    names = {
        name.id
        for statement in tree.body
        for name in ast.walk(statement)
        if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
    }
    imported = {
        alias.asname or alias.name
        for statement in tree.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    if "EFFECT" not in names | imported:
        raise ValueError(
            f"{path} holds no EFFECT, expected a dotsim_ros.effects.effect.Effect; write EFFECT = "
            "Effect(...), or move the file out of the folder. Nothing of it was run"
        )


def _effect_of(module: ModuleType, name: str, place: str) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        held = "no EFFECT" if effect is None else f"an EFFECT that is a {type(effect).__name__}"
        raise ValueError(
            f"{place} holds {held}, expected a dotsim_ros.effects.effect.Effect; write EFFECT = "
            "Effect(...), or move the file out of the folder"
        )
    if effect.name != name:
        raise ValueError(
            f"{place} holds the effect {effect.name!r}, expected its own name {name!r}; rename one "
            "of the two"
        )
    _check(effect, place)
    return effect


def _check(effect: Effect, place: str) -> None:
    """Refuse an effect that would fail in the middle of a search.

    Raises:
        ValueError: its parameters, channels or hooks are not as `Effect` has them.
    """
    if not effect.parameters or not all(
        isinstance(p, EffectParameter) and p.probes and p.low <= p.high for p in effect.parameters
    ):
        raise ValueError(
            f"{place}: parameters are {one_line(effect.parameters)[:200]}, expected at least one "
            "EffectParameter, each with a probe and low not above high"
        )
    if effect.parameters[0].none is None:
        raise ValueError(
            f"{place}: the first parameter, {effect.parameters[0].name}, is the size of the effect "
            "and has none=None, expected the value at which the effect is absent"
        )
    unknown = sorted(set(effect.channels) - {SKIN, FORCE, IMAGE})
    if unknown or not effect.channels:
        raise ValueError(
            f"{place}: channels are {effect.channels!r}, expected of {SKIN}, {FORCE}, {IMAGE}"
        )
    hooks = {hook: getattr(effect, hook) for hook in HOOKS}
    if all(call is None for call in hooks.values()):
        raise ValueError(f"{place}: the effect has no hook, expected one of {', '.join(HOOKS)}")
    _check_call(effect.excited_by, 1, f"{place}: excited_by")
    values = {parameter.name: parameter.probes[0] for parameter in effect.parameters}
    for hook, call in hooks.items():
        if call is None:
            continue
        _check_call(call, HOOKS[hook], f"{place}: the hook {hook}")
        if hook in FILTERS:
            try:
                made = call(values)
            except Exception as error:
                raise ValueError(
                    f"{place}: the hook {hook} fails with the probes {values}: "
                    f"{type(error).__name__}: {one_line(error)}; expected a filter"
                ) from error
            _check_call(made, FILTERS[hook], f"{place}: what the hook {hook} returns")


def _check_call(call: object, count: int, what: str) -> None:
    if not callable(call):
        raise ValueError(f"{what} is {one_line(repr(call))[:80]}, expected a function")
    try:
        inspect.signature(call).bind(*[None] * count)
    except TypeError as error:
        raise ValueError(
            f"{what} cannot be called with {count} argument{'s' * (count > 1)} ({error}); see "
            "docs/extend.md for what it is given"
        ) from error
    except ValueError:  # a built-in function without a signature
        return
