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
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from dotsim_ros.io.files import parameter_path
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

    @property
    def base64(self) -> str:
        """The content as a data URL takes it."""
        return base64.b64encode(self.png).decode("ascii")


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
    return template_files("report/page.j2", images_of(page), page=page)


def template_files(
    template: str, images: Iterable[ReportImage], **values: object
) -> dict[str, bytes]:
    """Return the files of a page that a template below `params/` makes of values, by name:
    `report.html`, `report.md` and its images.

    The template imports `macros`, those of the format: `params/report/html.j2`, or
    `markdown.j2` next to it.
    """
    files = {f"{image.name}.png": image.png for image in images}
    texts = {MARKDOWN: _rendered(template, "markdown", **values)}
    texts[HTML] = _rendered(template, "html", **values)
    return files | {name: printable(text).encode() for name, text in texts.items()}


def as_html(page: Page) -> str:
    """Return a page as one HTML file."""
    return _rendered("report/page.j2", "html", page=page)


def as_markdown(page: Page) -> str:
    """Return a page as Markdown; its images are PNG files next to it, under their names."""
    return _rendered("report/page.j2", "markdown", page=page)


def block_markdown(block: Block) -> str:
    """Return a block as Markdown."""
    return _rendered("report/block.j2", "markdown", block=block).strip()


def _rendered(template: str, layout: str, **values: object) -> str:
    text = _environment(layout == "html").get_template(template)
    rendered = text.render(macros=f"report/{layout}.j2", **values)
    return re.sub(r"\n{3,}", "\n\n", rendered).strip() + "\n"


@cache
def _environment(is_html: bool) -> Environment:
    environment = Environment(
        loader=FileSystemLoader(parameter_path("report").parent),
        autoescape=is_html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"one_line": _one_line, "plain": _plain, "cell": _cell}
    return environment


_MARKS = re.compile(r"[\\`*\[$~]|(?<![^\W_])_|_(?![^\W_])|^[#+-](?=[#\s-]|$)")
"""What Markdown would read as markup: underscores at the ends of words alone, and what begins a
heading, a list or a rule."""


def _one_line(text: str) -> str:
    """Return text, or what is HTML already, on one line."""
    return type(text)(" ".join(text.split()))


def _plain(text: str) -> str:
    """Return text on one line that Markdown takes as it is."""
    escaped = _MARKS.sub(r"\\\g<0>", one_line(text))
    return html.escape(escaped, quote=False)


def _cell(text: str) -> str:
    return _plain(text).replace("|", "\\|")
