# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write the table of the shipped effects into docs/api/effects.md, or check that it is up to date.

effects_table.py [--check]
"""

from __future__ import annotations

import sys
from pathlib import Path

from dotsim_ros.effects.effect import Effect, EffectParameter
from dotsim_ros.effects.library import load_effects

PAGE = Path(__file__).parents[1] / "docs" / "api" / "effects.md"
BEGIN = "<!-- .ci/effects_table.py writes this table. -->\n"
END = "\n<!-- End of the table. -->"
HEAD = (
    "effect",
    "acts on",
    "parameters and their range",
    "what excites it",
    "taken for",
)


def row_of(effect: Effect) -> tuple[str, ...]:
    """Return what an effect is, in the columns of `HEAD`."""
    hooks = {
        "gel": effect.gel,
        "pose": effect.motion,
        "skin and force": effect.response,
        "image": effect.image,
    }
    return (
        f"**{effect.title}** (`{effect.name}`): {effect.summary}",
        ", ".join(place for place, hook in hooks.items() if hook is not None),
        "; ".join(map(range_of, effect.parameters)),
        effect.protocol,
        ", ".join(f"`{name}`" if "_" in name else name for name in effect.taken_for) or "-",
    )


def range_of(parameter: EffectParameter) -> str:
    """Return a parameter's name, range, unit, and where it is absent."""
    ends = f"`{parameter.name}` {parameter.low:g} to {parameter.high:g} {parameter.unit}".rstrip()
    return ends if parameter.none is None else f"{ends}, none at {parameter.none:g}"


def table() -> str:
    """Return the table as Markdown."""
    rows = [HEAD, ("---",) * len(HEAD), *(row_of(effect) for effect in load_effects().values())]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |" for cells in rows
    )


def main() -> int:
    """Write or check the page; return the exit status."""
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    written = f"{before}{BEGIN}{table()}{END}{after}"
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(written, encoding="utf-8")
    elif written != text:
        print(f"{PAGE} is not what the effects say: run python .ci/effects_table.py")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
