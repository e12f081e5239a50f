# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Check the README and the built site: every link and anchor leads somewhere, nothing is fetched.

    check_links.py SITE [MARKDOWN...]

Fails on a relative link, image, script or style that is not there, on an anchor that its page does
not have, on a path out of the site, and on a script, style, font or image from elsewhere: the site
must open without a network. Links to other sites are counted, not followed. A Markdown file of the
repository (README.md) may lead to any file of it, by a link, a reference or HTML; anchors of pages
below docs/ are looked up in the built page, those of other Markdown files in their headings.
"""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
LINK = re.compile(r"!?\[(?:[^\]\[]|\[[^\]]*\])*\]\(([^)\s]+)\)")
DEFINITION = re.compile(r"^ {0,3}\[([^\]]+)\]:\s*<?([^\s>]+)", re.MULTILINE)
REFERENCE = re.compile(r"\[([^\]\[]+)\]\[([^\]\[]*)\]")
HEADING = re.compile(r"^#{1,6} +(.+?)[ #]*$", re.MULTILINE)
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
STYLE_URL = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+['\"]([^'\"]+)")
FETCHED = {"img": "src", "script": "src", "iframe": "src", "source": "src", "video": "src"}


class Page(HTMLParser):
    """What a page leads to, what it fetches, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element's links and anchors."""
        values = {name: value or "" for name, value in attrs}
        self.anchors |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if tag == "link" and values.get("rel") not in ("next", "prev", "canonical"):
            self.fetched.append(values.get("href", ""))
        if tag in FETCHED and values.get(FETCHED[tag]):
            self.fetched.append(values[FETCHED[tag]])


def anchors_of(text: str) -> set[str]:
    """Return the anchors that GitHub gives the headings of a Markdown file."""
    found: set[str] = set()
    for title in HEADING.findall(FENCED.sub("", text)):
        shown = LINK.sub(lambda link: link[0].rpartition("](")[0].lstrip("!["), title)
        anchor = free = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        number = 0
        while free in found:
            number += 1
            free = f"{anchor}-{number}"
        found.add(free)
    return found


class Checker:
    """Looks up targets; reads each page once.

    Attributes:
        bad: what is wrong, with the page that it stands on.
        outward: links to other sites.
        count: links that were looked up.
    """

    def __init__(self, site: Path, repository: Path = ROOT) -> None:
        self.site = site.resolve()
        self.repository = repository.resolve()
        self.bad: list[str] = []
        self.outward: set[str] = set()
        self.count = 0
        self._pages: dict[Path, Page] = {}

    def page(self, path: Path) -> Page:
        """Return a page of the site, read."""
        if path not in self._pages:
            self._pages[path] = Page(path.read_text(encoding="utf-8"))
        return self._pages[path]

    def check_site(self) -> None:
        """Check every page and style of the site."""
        for path in sorted(self.site.rglob("*.html")):
            page = self.page(path)
            for link in page.links:
                self._check(path, link, within=self.site)
            for link in page.fetched:
                if urlsplit(link).scheme or link.startswith("//"):
                    if not link.startswith("data:"):
                        self._blame(path, f"fetches {link}")
                else:
                    self._check(path, link, within=self.site)
        for path in sorted(self.site.rglob("*.css")):
            for match in STYLE_URL.finditer(path.read_text(encoding="utf-8")):
                link = match[1] or match[2]
                if link.startswith(("http:", "https:", "//")):
                    self._blame(path, f"fetches {link}")

    def check_markdown(self, path: Path) -> None:
        """Check a Markdown file of the repository."""
        path = path.resolve()
        text = CODE.sub("", path.read_text(encoding="utf-8"))
        defined = {label.lower(): target for label, target in DEFINITION.findall(text)}
        for words, label in REFERENCE.findall(text):
            if (label or words).lower() not in defined:
                self._blame(path, f"[{words}][{label}]: no such reference is defined")
        html = Page(text)
        for link in [*LINK.findall(text), *defined.values(), *html.links, *html.fetched]:
            self._check(path, link, within=self.repository)

    def _check(self, path: Path, link: str, *, within: Path) -> None:
        parts = urlsplit(link)
        if parts.scheme in ("http", "https", "mailto"):
            self.outward.add(link)
            return
        if parts.scheme:
            return
        self.count += 1
        place = unquote(parts.path)
        if path.name == "404.html":
            # A server shows this page for any address, so its links begin at the root.
            place = place.removeprefix("/")
        target = (path.parent / place).resolve() if place else path
        if not target.is_relative_to(within):
            self._blame(path, f"{link} leads out of {within.name}")
        elif not target.exists():
            self._blame(path, f"{link} leads nowhere")
        elif parts.fragment:
            anchors = self._anchors(target)
            if anchors is not None and unquote(parts.fragment) not in anchors:
                self._blame(path, f"{link}: the page has no such anchor")

    def _anchors(self, target: Path) -> set[str] | None:
        """Return the anchors of a page, or None of what is no page."""
        if target.is_relative_to(DOCS) and target.suffix == ".md":
            target = self.site / target.relative_to(DOCS).with_suffix(".html")
        if target.suffix == ".html" and target.is_file():
            return self.page(target).anchors
        if target.suffix == ".md" and target.is_file():
            return anchors_of(target.read_text(encoding="utf-8"))
        return None

    def _blame(self, path: Path, what: str) -> None:
        base = self.site if path.is_relative_to(self.site) else self.repository
        self.bad.append(f"{path.relative_to(base)}: {what}")


def main() -> int:
    """Check what the command line names; return the exit status."""
    site, *files = sys.argv[1:]
    checker = Checker(Path(site))
    checker.check_site()
    for file in files:
        checker.check_markdown(Path(file))
    if not checker.count:
        checker.bad.append(f"{site} holds no page with a link: build it first")
    print("\n".join(checker.bad) or "nothing wrong")
    print(f"{checker.count} links looked up, {len(checker.outward)} lead to other sites")
    return 1 if checker.bad else 0


if __name__ == "__main__":
    sys.exit(main())
