"""Finds the effects: those shipped, and files that a user drops into a folder."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from dotsim_ros.effects import builtin as effects
from dotsim_ros.effects.effect import Effect


def load_effects(folders: Sequence[str | Path] = ()) -> dict[str, Effect]:
    """Return every effect by name.

    Args:
        folders: of files that each hold an `EFFECT`; one of a shipped effect's name replaces it.

    Raises:
        FileNotFoundError: no such folder.
        ValueError: a file that cannot be run, or that holds no effect of its own name.
    """
    found = {}
    for info in pkgutil.iter_modules(effects.__path__):
        module = importlib.import_module(f"{effects.__name__}.{info.name}")
        found[info.name] = _effect_of(module, info.name, str(module.__file__))
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise FileNotFoundError(f"no folder of effects at {folder}")
        for path in sorted(folder.glob("*.py")):
            found[path.stem] = _effect_of(_run(path), path.stem, str(path))
    return found


def _run(path: Path) -> ModuleType:
    specification = importlib.util.spec_from_file_location(f"dotsim_ros_effect_{path.stem}", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    try:
        specification.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{path} cannot be run: {type(error).__name__}: {error}") from error
    return module


def _effect_of(module: ModuleType, name: str, place: str) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise ValueError(f"{place} holds no EFFECT, expected a dotsim_ros.effects.effect.Effect")
    if effect.name != name:
        raise ValueError(
            f"{place} holds the effect {effect.name!r}, expected its own name {name!r}"
        )
    return effect
