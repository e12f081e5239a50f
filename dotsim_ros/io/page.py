# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A report: sections of text, tables and images, as one HTML file or as Markdown.

The HTML needs nothing next to it: no script, no network, images inside. It is laid out for a
screen of 1280 pixels and for a phone of 400, where tables become lists and no image is drawn
smaller than it was made for.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dotsim_ros.io.printable import boxes_for_missing_glyphs, one_line, printable
from dotsim_ros.io.replacement import replace_files

HTML = "report.html"
MARKDOWN = "report.md"
PIXELS_PER_INCH = 100.0
"""Pixels of a page for an inch of a figure: a font of 8 points is 11 pixels high."""
LARGEST_WIDTH_INCHES = 3.6
"""Largest width of an image that fits a phone without being drawn smaller."""
_DOTS_PER_PIXEL = 2.0
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": "medium",
    "axes.labelsize": "medium",
    "figure.titlesize": "medium",
    "xtick.labelsize": "medium",
    "ytick.labelsize": "medium",
    "legend.fontsize": "medium",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


@dataclass(frozen=True)
class Paragraph:
    """Plain text."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of plain text."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Rows of plain text, each as long as the head."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class ReportImage:
    """An image.

    Attributes:
        name: of its file, without suffix.
        png: its content.
        alt: what it shows, for those who do not see it.
        width_px: on the page.
    """

    name: str
    png: bytes
    alt: str
    width_px: int


@dataclass(frozen=True)
class Gallery:
    """Images side by side, as many as there is room for."""

    images: tuple[ReportImage, ...]


Block = Paragraph | Bullets | Table | Gallery


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes:
        title: its heading.
        blocks: what it holds, in order.
        is_half: whether another one may stand next to it on a wide screen.
    """

    title: str
    blocks: tuple[Block, ...]
    is_half: bool = False


@dataclass(frozen=True)
class Page:
    """A report.

    Attributes:
        title: its heading.
        lead: the result in a sentence.
        sections: the rest, in order.
        label: the result in a word or two; may be empty.
        colour: of the label, as CSS names it.
    """

    title: str
    lead: str
    sections: tuple[Section, ...]
    label: str = ""
    colour: str = "#44505f"


@contextmanager
def page_figure(width_inches: float, height_inches: float) -> Iterator[Any]:
    """Yield an empty matplotlib figure in the page's style, to be drawn inside the block.

    Raises:
        ValueError: wider than `LARGEST_WIDTH_INCHES`.
    """
    import matplotlib

    # Not pyplot, which would keep figures and choose a display.
    from matplotlib.figure import Figure

    if width_inches > LARGEST_WIDTH_INCHES:
        raise ValueError(
            f"a figure {width_inches} inches wide, expected at most {LARGEST_WIDTH_INCHES}: on a "
            "phone its text could not be read; split it"
        )
    with matplotlib.rc_context(_STYLE):
        yield Figure(figsize=(width_inches, height_inches), layout="constrained")


def image_of(figure: Any, *, name: str, alt: str) -> ReportImage:
    """Return a matplotlib figure as an image, sharp on screens of twice the usual density."""
    buffer = io.BytesIO()
    with boxes_for_missing_glyphs():
        figure.savefig(buffer, format="png", dpi=PIXELS_PER_INCH * _DOTS_PER_PIXEL)
    width_px = round(float(figure.get_figwidth()) * PIXELS_PER_INCH)
    return ReportImage(name, buffer.getvalue(), alt, width_px)


def images_of(page: Page) -> list[ReportImage]:
    """Return all images of a page, in order."""
    return [
        image
        for section in page.sections
        for block in section.blocks
        if isinstance(block, Gallery)
        for image in block.images
    ]


def write_page(directory: Path, page: Page) -> Path:
    """Write a page as `report.html`, and as `report.md` with its images next to it, in place of
    the page before; return the former."""
    replace_files(directory, page_files(page))
    return directory / HTML


def page_files(page: Page) -> dict[str, bytes]:
    """Return the files of a page by name: `report.html`, `report.md` and the latter's images."""
    files = {f"{image.name}.png": image.png for image in images_of(page)}
    texts = {MARKDOWN: as_markdown(page), HTML: as_html(page)}
    return files | {name: printable(text).encode() for name, text in texts.items()}


def as_html(page: Page) -> str:
    """Return a page as one HTML file."""
    label = ""
    if page.label:
        label = f'<p class="label" style="background:{page.colour}">{html.escape(page.label)}</p>'
    sections = "\n".join(_section_html(section) for section in page.sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Without an icon of its own a browser asks the server for one.
        '<link rel="icon" href="data:,">'
        f"<title>{html.escape(page.title)}</title><style>{_CSS}</style></head>\n<body>"
        f'<header><h1>{html.escape(page.title)}</h1>{label}<p class="lead">'
        f"{html.escape(page.lead)}</p></header>\n<main>{sections}</main></body></html>\n"
    )


def as_markdown(page: Page) -> str:
    """Return a page as Markdown; its images are PNG files next to it, under their names."""
    label = f"**{_plain(page.label)}.** " if page.label else ""
    parts = [f"# {_plain(page.title)}", f"{label}{_plain(page.lead)}"]
    for section in page.sections:
        parts.append(f"## {_plain(section.title)}")
        parts += [block_markdown(block) for block in section.blocks]
    return "\n\n".join(parts) + "\n"


def _section_html(section: Section) -> str:
    kind = ' class="half"' if section.is_half else ""
    blocks = "\n".join(_block_html(block) for block in section.blocks)
    return f"<section{kind}><h2>{html.escape(section.title)}</h2>\n{blocks}</section>"


def _block_html(block: Block) -> str:
    match block:
        case Paragraph(text):
            return f"<p>{html.escape(text)}</p>"
        case Bullets(items):
            return "<ul>" + "".join(f"<li>{html.escape(item)}</li>" for item in items) + "</ul>"
        case Table(head, rows):
            return _table_html(head, rows)
        case Gallery(images):
            return '<div class="gallery">' + "".join(map(_image_html, images)) + "</div>"


def _table_html(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in head)
    body = "".join(
        "<tr>"
        + "".join(
            f'<td data-label="{html.escape(name)}">{html.escape(cell)}</td>'
            for name, cell in zip(head, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _image_html(image: ReportImage) -> str:
    data = base64.b64encode(image.png).decode("ascii")
    return (
        f'<img alt="{html.escape(image.alt)}" width="{image.width_px}" '
        f'src="data:image/png;base64,{data}">'
    )


def block_markdown(block: Block) -> str:
    """Return a block as Markdown."""
    match block:
        case Paragraph(text):
            return _plain(text)
        case Bullets(items):
            return "\n".join(f"- {_plain(item)}" for item in items)
        case Table(head, rows):
            shown = [[_plain(cell).replace("|", "\\|") for cell in line] for line in (head, *rows)]
            lines = [shown[0], ["---"] * len(head), *shown[1:]]
            return "\n".join(f"| {' | '.join(line)} |" for line in lines)
        case Gallery(images):
            return "\n\n".join(f"![{_plain(p.alt)}]({p.name}.png)" for p in images)


_MARKS = re.compile(r"[\\`*\[$~]|(?<![^\W_])_|_(?![^\W_])|^[#+-](?=[#\s-]|$)")
"""What Markdown would read as markup: underscores at the ends of words alone, and what begins a
heading, a list or a rule."""


def _plain(text: str) -> str:
    """Return text on one line that Markdown takes as it is."""
    escaped = _MARKS.sub(r"\\\g<0>", one_line(text))
    return html.escape(escaped, quote=False)


_CSS = """
*{box-sizing:border-box}
body{font:16px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;color:#1b2430;
background:#f4f6f8;margin:0;overflow-wrap:anywhere}
header,main{max-width:1220px;margin:0 auto;padding:0 16px}
header{padding-top:18px}
h1{font-size:17px;font-weight:600;color:#5a6675;margin:0 0 8px}
h2{font-size:16px;margin:0 0 8px}
.label{display:inline-block;color:#fff;font-weight:600;border-radius:4px;padding:2px 10px;margin:0}
.lead{font-size:22px;line-height:1.3;font-weight:600;margin:8px 0 16px}
main{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:14px;padding-bottom:30px}
section{background:#fff;border:1px solid #dbe1e7;border-radius:6px;padding:12px 16px;
grid-column:1/-1;min-width:0}
section.half{grid-column:span 1}
p,ul{margin:0 0 10px}
ul{padding-left:1.2em}
.gallery{display:flex;flex-wrap:wrap;gap:8px;align-items:flex-start}
img{max-width:100%;height:auto;display:block}
table{border-collapse:collapse;width:100%;font-size:14px;margin:0 0 10px}
td,th{padding:4px 10px 4px 0;text-align:left;border-bottom:1px solid #e3e8ed;vertical-align:top}
th{color:#5a6675;font-weight:600}
@media (max-width:760px){
header,main{padding-left:8px;padding-right:8px}
main{grid-template-columns:minmax(0,1fr);gap:8px}
section,section.half{grid-column:1/-1;padding:10px}
.lead{font-size:19px}
thead{display:none}
table,tbody,tr,td{display:block}
tr{border-bottom:1px solid #c9d2da;padding:6px 0}
td{border:0;padding:1px 0;display:grid;grid-template-columns:43% minmax(0,1fr);column-gap:8px}
td::before{content:attr(data-label);color:#5a6675}
td:first-child{display:block;font-weight:600}
td:first-child::before{content:none}
}
"""
