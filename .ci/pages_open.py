# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Open pages in headless Chromium, as wide as a screen and as a phone, and look at each.

    pages_open.py BROWSER IMAGES [--site FOLDER] PAGE...

Fails on a message of the console, an exception, a request for anything that is not in the page, a
image that did not load, that has no alternative text or that is drawn smaller than it was made
for, text under 11 pixels, and a page wider than its window. Leaves a screenshot of each in
IMAGES.

A report is one file and asks for nothing. With --site the pages are those of a site in FOLDER:
they may ask for files of that folder, parts of them may be hidden, or wider than the window within
a part that scrolls; and the search of the first page must find a word of its title.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

from playwright.sync_api import Page, Request, sync_playwright

WIDTHS_PX = (1280, 400)
HEIGHT_PX = 800
LOOK = """((width, isSite) => {
  const bad = [];
  const root = document.documentElement;
  if (root.scrollWidth > width) bad.push(`the page is ${root.scrollWidth} px wide`);
  const shown = {opacityProperty: true, visibilityProperty: true};
  const scrolls = element => {
    for (let around = element.parentElement; around !== root; around = around.parentElement)
      if (getComputedStyle(around).overflowX !== 'visible'
          && around.getBoundingClientRect().right <= width + 0.5) return true;
    return false;
  };
  for (const element of document.body.querySelectorAll('*')) {
    if (isSite && !element.checkVisibility(shown)) continue;
    const box = element.getBoundingClientRect();
    if (box.width && box.right > width + 0.5 && !(isSite && scrolls(element)))
      bad.push(`<${element.tagName}> ends at ${box.right} px: ${element.textContent.slice(0, 40)}`);
    const own = [...element.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
    if (own && parseFloat(getComputedStyle(element).fontSize) < 11)
      bad.push(`text under 11 px: ${element.textContent.slice(0, 40)}`);
  }
  for (const image of document.images) {
    const name = image.alt.slice(0, 40);
    if (!image.complete || !image.naturalWidth) bad.push(`not loaded: ${name}`);
    if (!image.alt) bad.push('an image without alternative text');
    if (image.clientWidth < 0.9 * Number(image.getAttribute('width')))
      bad.push(`drawn ${image.clientWidth} px wide, made for ${image.getAttribute('width')}: `
        + name);
  }
  return JSON.stringify({bad, images: document.images.length, height: root.scrollHeight,
    text: document.body.innerText.length});
})"""
SEARCH = """(async word => {
  const field = document.querySelector('input[name=query]');
  field.focus();
  field.value = word;
  field.dispatchEvent(new Event('keyup', {bubbles: true}));
  for (let tries = 0; tries < 1200; ++tries) {
    await new Promise(done => setTimeout(done, 100));
    const found = document.querySelectorAll('.md-search-result__item').length;
    if (found) return found;
  }
  return 0;
})"""


class Console:
    """What a page's console, its scripts and its requests should not have said.

    Args:
        page: that is listened to.
        own: address below which files may be asked for, next to the page itself; empty for none.
    """

    def __init__(self, page: Page, own: str) -> None:
        self.complaints: list[str] = []
        self._own = own
        page.on("console", lambda message: self.complaints.append(f"console: {message.text[:300]}"))
        page.on("pageerror", lambda error: self.complaints.append(f"exception: {error}"))
        page.on("request", self._on_request)

    def _on_request(self, request: Request) -> None:
        is_page = request.url.startswith("file:") and request.resource_type == "document"
        allowed = ("data:", self._own) if self._own else ("data:",)
        if not is_page and not request.url.startswith(allowed):
            self.complaints.append(f"asks for {request.url[:100]}")


def look(page: Page, path: Path, width_px: int, screenshot: Path, *, is_site: bool) -> list[str]:
    """Return what is wrong with a page, of a site or by itself, at a width."""
    page.goto(path.resolve().as_uri())
    seen = json.loads(page.evaluate(f"{LOOK}({width_px}, {json.dumps(is_site)})"))
    page.screenshot(path=screenshot, full_page=True)
    print(
        f"{path.parent.name}/{path.name} at {width_px} px: {seen['images']} images, "
        f"{seen['text']} characters, {seen['height']} px high"
    )
    if not seen["text"]:
        seen["bad"].append("nothing to read")
    return list(seen["bad"])


def name_of(page: Path, site: Path | None) -> str:
    """Return what a page's screenshots are called: reports lie in a folder each."""
    if site is None:
        return page.parent.name
    return "_".join(page.resolve().relative_to(site.resolve()).with_suffix("").parts)


def search(page: Page, path: Path) -> list[str]:
    """Return what is wrong with the search of a site, asked on a page for a word of its title."""
    page.goto(path.resolve().as_uri())
    word = max(page.title().split(), key=len)
    count = page.evaluate(f"{SEARCH}({json.dumps(word)})")
    print(f"the search finds {word!r} on {count} pages")
    return [] if count else [f"the search finds nothing for {word!r}"]


def main() -> int:
    """Look at all pages; return the exit status."""
    program, images, *pages = sys.argv[1:]
    site = None
    if pages[0] == "--site":
        site = Path(pages[1])
        del pages[:2]
    own = "" if site is None else f"{site.resolve().as_uri()}/"
    bad = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which(program), args=["--no-sandbox"]
        )
        for width_px in WIDTHS_PX:
            page = browser.new_page(
                viewport={"width": width_px, "height": HEIGHT_PX},
                is_mobile=width_px < 600,
                # Or parts of a site that fade in are not there yet.
                reduced_motion="reduce",
            )
            console = Console(page, own)
            for path in map(Path, pages):
                shot = Path(images) / f"{name_of(path, site)}_{width_px}.png"
                wrong = look(page, path, width_px, shot, is_site=site is not None)
                bad += [f"{path} at {width_px} px: {what}" for what in wrong + console.complaints]
                console.complaints.clear()
        if site is not None:
            bad += search(page, Path(pages[0])) + console.complaints
        browser.close()
    print("\n".join(bad) or "nothing wrong")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
