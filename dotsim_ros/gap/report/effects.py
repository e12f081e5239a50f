"""The library of effects as a table, for the documentation and for whoever plans recordings."""

from __future__ import annotations

import importlib
import inspect

from dotsim_ros.effects import builtin as effects
from dotsim_ros.effects.effect import Effect, EffectParameter
from dotsim_ros.effects.library import load_effects
from dotsim_ros.page import Table

HEAD = (
    "effect (its file)",
    "what it does",
    "acts on",
    "parameters and their range",
    "what excites it",
    "taken for",
)


def effects_table() -> Table:
    """Return what each shipped effect is, a row a file of `dotsim_ros/effects/builtin`."""
    return Table(HEAD, tuple(_row(effect) for effect in load_effects().values()))


def _row(effect: Effect) -> tuple[str, ...]:
    places = {
        "gel": effect.gel,
        "pose": effect.motion,
        "skin and force": effect.response,
        "image": effect.image,
    }
    return (
        f"{effect.title} (`{effect.name}`)",
        _term(effect.name),
        ", ".join(place for place, hook in places.items() if hook is not None),
        "; ".join(map(_parameter, effect.parameters)),
        effect.protocol,
        ", ".join(f"`{name}`" if "_" in name else name for name in effect.taken_for) or "-",
    )


def _term(name: str) -> str:
    """Return what the effect's module says that it does: the summary, without its subject."""
    module = importlib.import_module(f"{effects.__name__}.{name}")
    summary = (inspect.getdoc(module) or "").partition("\n\n")[0]
    return " ".join(summary.partition(":")[2].split())


def _parameter(parameter: EffectParameter) -> str:
    ends = f"`{parameter.name}` {parameter.low:g} to {parameter.high:g} {parameter.unit}"
    absent = "" if parameter.none is None else f", none at {parameter.none:g}"
    return ends.rstrip() + absent
