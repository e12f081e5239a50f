# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The report of a search for a gap: a page, the same as Markdown, images, and the figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.overlay import FILE_NAME, Overlay, overlay_text
from dotsim_ros.gap.findings import Findings, Verdict, as_record
from dotsim_ros.gap.report.page import report_files
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.page import HTML
from dotsim_ros.io.provenance import provenance
from dotsim_ros.io.replacement import finish_replacement, replace_files

FINDINGS = "findings.json"
PROVENANCE = "provenance.json"
REPORT_BEFORE = "report_before"
"""Folder of the report that data which cannot be used have put out of its place."""


def write_report(
    directory: str | Path,
    findings: Findings,
    *,
    effects: Mapping[str, Effect],
    overlay: Overlay | None = None,
) -> Path:
    """Write findings into a folder in place of those of an earlier search, all files or none.

    The folder gets `findings.json` (as `findings_of` reads it), `provenance.json`, `report.html`,
    which needs none of the others, `report.md`, the images of the latter, and the overlay where
    there is one. What the report before wrote goes; where the new one only says that data cannot
    be used, the one before is kept in `REPORT_BEFORE`. Files of the user stay, as `replace_files`
    says.

    Args:
        directory: made where it is absent.
        findings: what was found.
        effects: the library that was searched, as `load_effects` returns it.
        overlay: the named effects; with None no overlay is left in the folder.

    Returns:
        The HTML page.

    Raises:
        OSError: it could not be written; the report before is still there.
    """
    directory = Path(directory)
    finish_replacement(directory)
    is_unusable = findings.verdict is Verdict.UNUSABLE
    origin = provenance()
    replace_files(
        directory,
        {
            FILE_NAME: None if overlay is None else overlay_text(overlay).encode(),
            FINDINGS: _json(as_record(findings)),
            PROVENANCE: _json(origin),
            **report_files(findings, origin, effects),
        },
        keep_as=REPORT_BEFORE if is_unusable and not _is_unusable(directory / FINDINGS) else None,
    )
    return directory / HTML


def _is_unusable(path: Path) -> bool:
    """Return whether the report that is there says that data could not be used."""
    try:
        findings = read_json(path)
    except (OSError, ValueError):
        return False
    return isinstance(findings, dict) and findings.get("verdict") == Verdict.UNUSABLE.value


def _json(figures: Mapping[str, Any]) -> bytes:
    return (json.dumps(figures, indent=2) + "\n").encode()
