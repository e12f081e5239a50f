"""The report of a search for a gap: a page, the same as Markdown, images, and the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import FILE_NAME, Overlay, write_overlay
from dotsim_ros.files import write_json
from dotsim_ros.gap.findings import Findings, as_record
from dotsim_ros.gap.report.sections import page_of
from dotsim_ros.page import write_page
from dotsim_ros.provenance import provenance

FINDINGS = "findings.json"
PROVENANCE = "provenance.json"


def write_findings(
    directory: Path,
    findings: Findings,
    overlay: Overlay | None,
    *,
    effects: Sequence[Path] = (),
) -> None:
    """Write a report, and the overlay where there is one, in place of those of an earlier search.

    Args:
        directory: made where it is absent.
        findings: what was found.
        overlay: the named effects.
        effects: folders of the user's own.
    """
    directory.mkdir(parents=True, exist_ok=True)
    if overlay is None:
        (directory / FILE_NAME).unlink(missing_ok=True)
    else:
        write_overlay(directory / FILE_NAME, overlay)
    write_report(directory, findings, effects=load_effects(effects))


def write_report(
    directory: str | Path, findings: Findings, *, effects: Mapping[str, Effect]
) -> Path:
    """Write findings into a folder, each file whole or not at all.

    The folder gets `findings.json` (as `findings_of` reads it), `provenance.json`, `report.html`,
    which needs none of the others, `report.md`, and the images of the latter; those of the report
    before go.

    Args:
        directory: made where it is absent.
        findings: what was found.
        effects: the library that was searched, as `load_effects` returns it.

    Returns:
        The HTML page.
    """
    directory = Path(directory)
    origin = provenance()
    write_json(directory / FINDINGS, as_record(findings))
    write_json(directory / PROVENANCE, origin)
    return write_page(directory, page_of(findings, origin, effects))
