# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write the table of the profiles' errors into docs/run.md, or check that it is up to date.

profiles_table.py [--check]
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "run.md"
RESULTS = "docs/results/profiles.json"
FIGURES = re.compile(rf"(<!-- figures: {re.escape(RESULTS)} at )[^\s:]+(:| -->)")
BEGIN = "<!-- .ci/profiles_table.py writes this table, and the commit above. -->\n"
END = "\n<!-- End of the table. -->"
HEAD = (
    "profile",
    "sensor",
    "grid",
    "skin, median",
    "skin, 99 %",
    "skin, largest",
    "documented",
    "force, mean",
    "force, largest",
    "time of the gel",
)


def rows_of(figures: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each profile and sensor: the worst of its indenters."""
    rows = []
    sensors = dict.fromkeys(case["sensor"] for case in figures["cases"])
    for name, worst in figures["worst"].items():
        for sensor in sensors:
            found = [c["profiles"][name] for c in figures["cases"] if c["sensor"] == sensor]
            if name == "exact":
                continue
            rows.append(
                (
                    f"`{name}`",
                    f"`{sensor}`",
                    f"{found[0]['grid_spacing_mm']:.1f} mm",
                    *(
                        f"{max(row[key] for row in found):.2f} mm"
                        for key in ("skin_p50_mm", "skin_p99_mm", "skin_max_mm")
                    ),
                    f"{worst['documented_mm']:.1f} mm",
                    *(
                        f"{max(row[key] for row in found):.1f} %"
                        for key in ("force_mean_percent", "force_max_percent")
                    ),
                    f"{min(row['time_ratio'] for row in found):.2f} to "
                    f"{max(row['time_ratio'] for row in found):.2f}",
                )
            )
    return rows


def notes_of(figures: dict[str, Any]) -> str:
    """Return what else the figures say, as a list in Markdown."""
    handovers = [row for case in figures["cases"] for row in case["handovers"]]
    changed = [row for row in handovers if row["largest_jump_mm"] > 0.0]
    start = list(figures["start"].values())
    lines = [
        f"A change of the grid during the slide moved the skin by at most "
        f"{max(row['largest_jump_mm'] for row in handovers):.2f} mm and took at most "
        f"{max(row['longest_ms'] for row in changed):.0f} ms; "
        f"{sum(row['refused'] for row in changed)} of {sum(row['tried'] for row in changed)} were "
        f"refused. The other gel pressed anew at the same pose would have moved it by up to "
        f"{max(row['largest_jump_if_pressed_anew_mm'] for row in changed):.1f} mm.",
        f"With its tables on disk `auto` took up to {max(row['others_s'] for row in start):.1f} s "
        f"and {max(row['others_mb'] for row in start):.0f} MB more at the start than one profile, "
        f"which took up to {max(row['one_s'] for row in start):.1f} s and "
        f"{max(row['one_mb'] for row in start):.0f} MB. Timing the profiles comes on top of it.",
    ]
    for case in figures["deep"]:
        row = case["profiles"]["realtime"]
        lines.append(
            f"Beyond what is documented: `{case['indenter']}` {case['depth_mm']:.1f} mm deep in "
            f"`{case['sensor']}`, `realtime` was off by up to {row['skin_max_mm']:.2f} mm and "
            f"{row['force_max_percent']:.0f} % of the force; {row['unconverged_frames']} of "
            f"{case['frames']} frames were marked as not converged."
        )
    return "\n".join(f"- {line}" for line in lines)


def page_with(figures: dict[str, Any], text: str) -> str:
    """Return the page with the table of the figures."""
    table = "\n".join(
        "| " + " | ".join(cells) + " |" for cells in (HEAD, ("---",) * len(HEAD), *rows_of(figures))
    )
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    written = f"{before}{BEGIN}\n{table}\n\n{notes_of(figures)}\n{END}{after}"
    return FIGURES.sub(rf"\g<1>{figures['provenance']['commit']}\g<2>", written)


def main() -> int:
    """Write or check the page; return the exit status."""
    text = PAGE.read_text(encoding="utf-8")
    figures = json.loads((ROOT / RESULTS).read_text(encoding="utf-8"))
    written = page_with(figures, text)
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(written, encoding="utf-8")
    elif written != text:
        print(f"{PAGE} is not what {RESULTS} says: run python .ci/profiles_table.py")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
