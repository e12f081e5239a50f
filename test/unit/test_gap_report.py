# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The report of a gap: every verdict, missing parts, its page by itself, its files."""

from __future__ import annotations

import hashlib
import html
import io
import json
import math
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pytest
from gap_findings import EXAMPLES, named, no_gap, of_set, places, unknown
from PIL import Image

from dotsim_ros.cli.main import main
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import FILE_NAME, Estimate, FoundEffect, Overlay, read_overlay
from dotsim_ros.gap.find import combined
from dotsim_ros.gap.findings import (
    Candidate,
    ChannelGap,
    Findings,
    OpticalFindings,
    ResidualPlace,
    TileGap,
    Verdict,
    as_record,
    findings_of,
)
from dotsim_ros.gap.report.figures import by_phase, by_trajectory, heatmap
from dotsim_ros.gap.report.page import report_files
from dotsim_ros.gap.report.write import write_report
from dotsim_ros.io.page import (
    Bullets,
    Page,
    Section,
    Table,
    as_html,
    as_markdown,
)
from dotsim_ros.io.replacement import MANIFEST, replace_files

VOID = {"meta", "link", "img", "br"}


class Reader(HTMLParser):
    """Reads a page and keeps what must hold of it: every element closed, every source, the text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.alternatives: list[str] = []
        self.tags: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        values = dict(attrs)
        self.sources += [values[name] or "" for name in ("src", "href") if name in values]
        if tag == "img":
            self.alternatives.append(values.get("alt") or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def test_the_finished_report_that_is_shipped_names_its_effect_and_its_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["find-gap", "--example"]) == 0
    path = Path(url2pathname(urlsplit(capsys.readouterr().out.strip()).path))
    assert path.stat().st_size < 1.5e6
    page = read(path.read_text(encoding="utf-8"))
    assert "Coulomb slip at another friction is missing" in page.text
    assert "dotsim_ros find-gap --demo" in page.text
    assert "script" not in page.tags
    assert page.sources
    assert all(source.startswith("data:") for source in page.sources)
    assert main(["find-gap", "--example", "--alpha", "0.1"]) == 1
    assert "--example shows a finished report: leave out --alpha" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["named", "unusable", "without_skin"])
def test_a_report_needs_no_other_file_and_its_images_are_whole(name: str, tmp_path: Path) -> None:
    findings = EXAMPLES[name]()
    path = write_report(tmp_path, findings, effects=load_effects())

    page = read(path.read_text(encoding="utf-8"))
    assert findings.sentence in page.text
    assert all(source.startswith("data:") for source in page.sources)
    assert "script" not in page.tags
    assert all(len(text) > 10 for text in page.alternatives)
    for warning in findings.warnings:
        assert warning in page.text

    images = sorted(tmp_path.glob("*.png"))
    assert len(images) == len(page.alternatives)
    for image in images:
        with Image.open(io.BytesIO(image.read_bytes())) as opened:
            opened.load()
            assert min(opened.size) > 100
    markdown = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert html.escape(findings.sentence, quote=False) in markdown.replace("\\[", "[")
    assert all(f"]({image.name})" in markdown for image in images)
    assert "http" not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["set", "without_skin"])
def test_findings_come_back_from_json(name: str) -> None:
    findings = EXAMPLES[name]()
    record = json.loads(json.dumps(as_record(findings)))
    assert findings_of(record) == findings
    with pytest.raises(ValueError, match="version 7, expected 1"):
        findings_of({**record, "version": 7})


def files_below(folder: Path) -> dict[str, bytes]:
    found = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def test_a_report_leaves_nothing_of_the_report_before(tmp_path: Path) -> None:
    slip = Overlay(
        "sensor_a", "0123", (FoundEffect("coulomb_slip", named().candidates[0].estimates),)
    )
    before = replace(named(), worst=None, places=places()[-7:])
    write_report(tmp_path, before, effects=load_effects(), overlay=slip)
    assert read_overlay(tmp_path / FILE_NAME) == slip
    assert (tmp_path / "phases_after.png").exists()
    after = replace(no_gap(), places=(), gaps=())
    write_report(tmp_path, after, effects=load_effects())
    left = files_below(tmp_path)
    texts = {"findings.json", "provenance.json", "report.html", "report.md"}
    assert set(left) == {*texts, "ranking.png", MANIFEST}
    assert findings_of(json.loads(left["findings.json"])) == after
    assert json.loads(left["provenance.json"])["commit"]


def test_files_that_no_report_wrote_are_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    folder.mkdir()
    outside = tmp_path / "outside.png"
    outside.write_bytes(b"")
    digest = hashlib.sha256(b"").hexdigest()
    for manifest in (f'{{"../outside.png": "{digest}"}}', "[1]", "no JSON"):
        (folder / MANIFEST).write_text(manifest, encoding="utf-8")
        replace_files(folder, {"a.png": b"a"})
        replace_files(folder, {"b.png": b"b"})
        assert outside.exists()
        assert set(files_below(folder)) == {"b.png", MANIFEST}


def plain(findings: Findings) -> Findings:
    """Return findings without what is drawn: an image takes a second."""
    return replace(findings, worst=None, places=(), gaps=())


def text_of(findings: Findings) -> str:
    return read(report_files(findings, {}, load_effects())["report.html"].decode()).text


def test_a_named_effect_is_reported_with_its_numbers() -> None:
    text = text_of(replace(named(), worst=None, places=()))
    assert "Effect named" in text
    assert "friction_ratio = 1.52 (1.41 to 1.66)" in text
    assert "Share of the gap closed on the held-out trajectories: 96 % (91 % to 99 %)" in text
    assert "skin: 0.052 mm, 1.04 times the floor: no detectable gap remains" in text
    assert "force: 0.05 N, 1.25 times the floor: a gap remains" in text
    rows = report_files(named(), {}, {})["report.md"].decode()
    assert "| way to the onset of slip | slide | 0.81 mm | 0.53 mm | 0.8 mm | 0.09 mm |" in rows
    assert "offset_z = 0.02 (prior -0.01 to 0.05) mm" in text
    assert "neither found nor excluded" in text
    assert "the name is not stable" not in text


def test_what_a_user_gains_is_one_picture_and_a_table() -> None:
    seen = replace(optical(Verdict.NAMED), psnr_db=(24.1, 25.0, 31.2))
    both = combined(replace(named(), worst=None, places=()), seen)
    table = [list(row.values()) for row in as_record(both)["user_gaps"]]
    assert table[0] == ["image", "dB", 24.1, 25.0, 31.2, None]
    assert table[1] == ["skin", "mm", *(pytest.approx(one) for one in (0.21, 0.15, 0.052, 0.05))]
    assert table[2] == ["force", "N", 0.31, 0.22, 0.05, 0.04]
    files = report_files(both, {}, {})
    first = files["report.md"].decode().split("## At a glance")[1].split("## ")[0]
    assert "image, dB: before 24.1, recalibrated 25, after 31.2; skin, mm: before" in first
    assert "](user_gaps.png)" in first
    # What is named in the images adds nothing to skin and force.
    of_images = combined(replace(unknown(), worst=None, places=()), seen).user_gaps()
    assert [gap.after for gap in of_images] == [31.2, None, None]


def test_a_set_comes_with_what_would_separate_it() -> None:
    text = text_of(plain(of_set()))
    assert "slides in two opposite directions" in text
    assert "do not distinguish Coulomb slip at another friction from: Pose offset" in text
    assert "60 % of bootstrap repetitions" in text
    assert "the name is not stable" in text
    rows = report_files(of_set(), {}, {})["report.md"].decode()
    assert "| an effect outside the library | 1 % |" in rows
    asked = "a slide of 4 mm, 2 mm deep, at 5 mm/s at the apex | 17 s | 0.52 | 1.8 | pose offset"
    assert f"| asked_1_slide | ball | {asked} |" in rows


def test_nothing_named_has_no_after() -> None:
    fallback = (ChannelGap("force", "N", 0.31, 0.22, 0.1, 0.04),)
    findings = replace(
        unknown(), worst=None, places=places()[-7:], fallback=fallback, stability=0.4
    )
    files = report_files(findings, {}, {})
    assert not [name for name in files if "after" in name]
    text = files["report.md"].decode()
    assert "no effect was added" in text
    assert "changes the residual of the held-out trajectories: force 0.22 N to 0.1 N. It is" in text
    assert "expected 67 % at least to name it" in text


@pytest.mark.parametrize("verdict", list(Verdict))
def test_every_verdict_renders_without_anything_else(verdict: Verdict) -> None:
    findings = Findings(verdict, "A sentence.")
    assert findings.sentence in text_of(findings)


def test_places_are_summed_over_trajectories_as_stated_and_over_phases_by_their_counts() -> None:
    def place(trajectory: str, phase: str, before: float, count: int) -> ResidualPlace:
        return ResidualPlace("force", trajectory, phase, "load", before, before, 0.0, 0.0, count)

    found = [
        place("a", "hold", 1.0, 10),
        place("b", "hold", 3.0, 10),
        place("all", "hold", 2.5, 20),
    ]
    found += [place("a", "idle", 2.0, 20), place("all", "idle", 2.0, 20)]
    table = by_phase(found)
    assert (table.rows, table.columns) == (["force, load"], ["idle", "hold"])
    assert table.before.tolist() == [[2.0, 2.5]]
    table = by_trajectory(found)
    assert (table.rows, table.columns) == (["a", "b"], ["force, load"])
    assert table.before.ravel() == pytest.approx([math.sqrt(3.0), 3.0])


def test_of_many_trajectories_the_strongest_are_shown() -> None:
    places = [
        ResidualPlace("force", f"t{size}", "idle", "load", size, size, 0.0, 0.0, 5)
        for size in range(40)
    ]
    table = by_trajectory(places)
    image = heatmap(table, table.before, name="a", title="By trajectory")
    assert image.alt == "By trajectory: the 30 strongest of 40: largest 39 at t39, force, load"


def test_many_warnings_are_counted_first_and_listed_later() -> None:
    warnings = tuple(f"Warning number {k}." for k in range(20))
    files = report_files(replace(plain(named()), warnings=warnings), {}, {})
    text = files["report.md"].decode()
    first, rest = text.split("## Candidates by rank")
    assert "20 warnings limit what can be concluded" in first
    assert "\n## Warnings: what cannot be concluded\n\n- Warning number 0.\n- " in rest
    assert all(warning in files["report.html"].decode() for warning in warnings)


def test_text_is_never_taken_for_markup() -> None:
    hostile = '<img src="http://example.org"> | [x](y) *z*'
    page = Page(hostile, hostile, (Section(hostile, (Table((hostile,), ((hostile,),)),)),), hostile)
    read_page = read(as_html(page))
    assert read_page.sources == ["data:,"]
    assert read_page.text.count(hostile) == 7
    markdown = as_markdown(replace(page, sections=(Section("a", (Bullets((hostile,)),)),)))
    assert "<img" not in markdown
    assert "[x]" not in markdown.replace("\\[x]", "")


def markdown_of(findings):
    """Return the report without what is drawn of skin and force: an image takes a second."""
    return report_files(plain(findings), {}, load_effects())["report.md"].decode()


def test_effects_that_were_not_tried_are_in_the_report_and_the_record():
    found = replace(optical(Verdict.NO_GAP), not_tried=("my_tint",))
    both = combined(no_gap(), found)
    assert findings_of(as_record(both)) == both
    text = markdown_of(both)
    assert "## Not tried" in text
    assert "my_tint" in text
    assert "--fit-optical-noise" in text
    older = as_record(both)
    del older["optical"]["not_tried"]
    assert findings_of(older).optical.not_tried == ()


def optical(verdict):
    """Return a part of the images with a verdict."""
    found = verdict in (Verdict.NAMED, Verdict.SET)
    loss = Estimate("edge_loss", "", 0.1, 0.08, 0.12)
    vignetting = Candidate(
        "vignetting", "Vignetting", True, 88.0, 0.1, 0.9, None, (loss,) if found else ()
    )
    return OpticalFindings(
        verdict,
        f"Images: {verdict.value}.",
        named=("vignetting",) if found else (),
        alternatives=("gamma",) if verdict is Verdict.SET else (),
        statistic=88.0,
        threshold=11.0,
        candidates=(vignetting, Candidate("motion_blur", "Motion blur", False, 0.0, 0.0)),
        gap=ChannelGap("image", "levels", 2.0, 1.9, 0.8, 0.8),
        share_closed=0.97 if found else None,
        share_closed_low=0.9 if found else None,
        share_closed_high=1.0 if found else None,
        stability=1.0 if found else None,
        tiles=(TileGap(0.4, 0.5, 3.0, 1.0), TileGap(0.6, 0.5, 2.0, 1.0)),
        warnings=("2 trajectories with images are few",),
        trajectories=("idle", "press_0"),
        frame_count=1 + 4,
        noise_source="19 trajectories of sensor_a",
    )


@pytest.mark.parametrize(
    ("gel", "images", "expected"),
    [
        (no_gap, Verdict.NO_GAP, Verdict.NO_GAP),
        (no_gap, Verdict.NAMED, Verdict.NAMED),
        (named, Verdict.UNKNOWN, Verdict.NAMED),
        (unknown, Verdict.NO_GAP, Verdict.UNKNOWN),
        (no_gap, Verdict.UNKNOWN, Verdict.UNKNOWN),
        (no_gap, Verdict.UNUSABLE, Verdict.NO_GAP),
        (named, Verdict.UNUSABLE, Verdict.NAMED),
    ],
)
def test_both_parts_make_one_verdict(gel, images, expected):
    both = combined(gel(), optical(images))
    assert both.verdict is expected
    assert both.sentence.startswith(gel().sentence)
    assert both.sentence.endswith(f"Images: {images.value}.")
    assert both.named == gel().named + optical(images).named
    assert findings_of(as_record(both)) == both
    assert "2 trajectories with images are few" in both.warnings
    # Images alone.
    assert combined(replace(no_gap(), sentence=""), optical(images)).verdict is images


def test_the_report_keeps_the_parts_apart(tmp_path: Path):
    both = combined(named(), optical(Verdict.NAMED))
    text = markdown_of(both)
    assert "## Images" in text
    assert "1. Vignetting (vignetting), added" in text
    assert "Share of the images' gap closed, in expected deviations of all tiles: 97 %" in text
    assert "19 trajectories of sensor_a" in text
    assert "1. Coulomb slip at another friction (coulomb_slip), added" in text
    # What no image excites stands next to what no press does.
    assert "| Motion blur |" in text
    refused = markdown_of(combined(no_gap(), optical(Verdict.UNUSABLE)))
    assert "Images: unusable." in refused
    assert "Images: candidates by rank" not in refused
