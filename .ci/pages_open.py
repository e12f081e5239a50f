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

Chromium is spoken to in its DevTools protocol over a pipe (file descriptors 3 and 4, messages ended
by a zero byte), which needs no package next to Python and no port.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

WIDTHS_PX = (1280, 400)
HEIGHT_PX = 800
LIMIT_S = 120.0
PAGE_LIMIT_S = 10.0
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


class Browser:
    """Chromium, one page, spoken to over a pipe; it is ended after `limit_s`."""

    def __init__(self, program: str, profile: str, limit_s: float) -> None:
        to_read, self._to = os.pipe()
        self._from, to_write = os.pipe()
        # Chromium reads commands from 3 and writes to 4; a shell moves what was inherited there.
        self.process = subprocess.Popen(
            [
                "bash",
                "-c",
                f'exec "$0" "$@" 3<&{to_read} 4>&{to_write}',
                program,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--hide-scrollbars",
                "--no-first-run",
                "--disable-background-networking",
                "--remote-debugging-pipe",
                f"--user-data-dir={profile}",
                "about:blank",
            ],
            pass_fds=(to_read, to_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._watchdog = threading.Timer(limit_s, self.process.kill)
        self._watchdog.start()
        self._buffer = b""
        self._count = 0
        self.events: list[dict[str, Any]] = []
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return what a command answers; events before that are kept."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])
            self.events.append(answer)

    def wait_for(self, method: str) -> None:
        """Return once an event has come."""
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self._receive())

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            chunk = os.read(self._from, 1 << 16)
            if not chunk:
                raise RuntimeError(f"{self.process.args[3]} ended; does it start by itself?")
            self._buffer += chunk
        message, self._buffer = self._buffer.split(b"\0", 1)
        return dict(json.loads(message))

    def close(self) -> None:
        """End the browser."""
        self._watchdog.cancel()
        self.process.terminate()
        self.process.wait()


def complaints(events: list[dict[str, Any]], site: Path | None) -> list[str]:
    """Return what the console, the log and the network said that they should not have.

    Args:
        events: of the browser.
        site: folder of the site whose files the page may ask for; None: for nothing.
    """
    own = None if site is None else f"{site.resolve().as_uri()}/"
    found = []
    for event in events:
        what = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown" | "Runtime.consoleAPICalled" | "Log.entryAdded":
                found.append(f"{event['method']}: {json.dumps(what)[:300]}")
            case "Network.requestWillBeSent":
                url = what["request"]["url"]
                if own is not None and url.startswith(own):
                    continue
                if not url.startswith(("data:", "file:")) or (
                    url.startswith("file:") and what["type"] != "Document"
                ):
                    found.append(f"asks for {url[:100]}")
    return found


def look(
    browser: Browser, page: Path, width_px: int, screenshot: Path, site: Path | None
) -> list[str]:
    """Return what is wrong with a page, of a site or by itself, at a width."""
    size = {"width": width_px, "height": HEIGHT_PX, "deviceScaleFactor": 1}
    browser.call("Emulation.setDeviceMetricsOverride", **size, mobile=width_px < 600)
    if site is not None:
        # Or parts that fade in are not there yet.
        still = [{"name": "prefers-reduced-motion", "value": "reduce"}]
        browser.call("Emulation.setEmulatedMedia", features=still)
    browser.events.clear()
    browser.call("Page.navigate", url=page.resolve().as_uri())
    browser.wait_for("Page.loadEventFired")
    asked = f"{LOOK}({width_px}, {json.dumps(site is not None)})"
    seen = json.loads(browser.call("Runtime.evaluate", expression=asked)["result"]["value"])
    shot = browser.call("Page.captureScreenshot", captureBeyondViewport=True, format="png")
    screenshot.write_bytes(base64.b64decode(shot["data"]))
    print(
        f"{page.parent.name}/{page.name} at {width_px} px: {seen['images']} images, "
        f"{seen['text']} characters, {seen['height']} px high"
    )
    if not seen["text"]:
        seen["bad"].append("nothing to read")
    return [*seen["bad"], *complaints(browser.events, site)]


def name_of(page: Path, site: Path | None) -> str:
    """Return what a page's screenshots are called: reports lie in a folder each."""
    if site is None:
        return page.parent.name
    return "_".join(page.resolve().relative_to(site.resolve()).with_suffix("").parts)


def search(browser: Browser, page: Path, site: Path) -> list[str]:
    """Return what is wrong with the search of a site, asked on a page for a word of its title."""
    browser.events.clear()
    browser.call("Page.navigate", url=page.resolve().as_uri())
    browser.wait_for("Page.loadEventFired")
    title = browser.call("Runtime.evaluate", expression="document.title")["result"]["value"]
    word = max(title.split(), key=len)
    asked = f"{SEARCH}({json.dumps(word)})"
    answer = browser.call("Runtime.evaluate", expression=asked, awaitPromise=True)["result"]
    print(f"the search finds {word!r} on {answer.get('value', 0)} pages")
    bad = [] if answer.get("value") else [f"the search finds nothing for {word!r}"]
    return [*bad, *complaints(browser.events, site)]


def main() -> int:
    """Look at all pages; return the exit status."""
    program, images, *pages = sys.argv[1:]
    site = None
    if pages[0] == "--site":
        site = Path(pages[1])
        del pages[:2]
    Path(images).mkdir(parents=True, exist_ok=True)
    bad = []
    # The browser may still be writing into its profile as it ends.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(program, profile, LIMIT_S + PAGE_LIMIT_S * len(pages))
        try:
            for page in map(Path, pages):
                for width_px in WIDTHS_PX:
                    shot = Path(images) / f"{name_of(page, site)}_{width_px}.png"
                    wrong = look(browser, page, width_px, shot, site)
                    bad += [f"{page} at {width_px} px: {what}" for what in wrong]
            if site is not None:
                bad += search(browser, Path(pages[0]), site)
        finally:
            browser.close()
    print("\n".join(bad) or "nothing wrong")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
