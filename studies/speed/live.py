# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From the mouse to the skin: how long the live page takes to show what a drag has moved.

Starts `dotsim_ros live`, opens its page in headless Chromium without a graphics card, drags the
indenter 2 mm into the apex and along the skin, and asks the page for the times from each event of
the mouse to the drawing of the first skin that shows it. Browser, sensor and rendering share the
machine's cores, as they do for a user without a graphics card. Before, a reader that draws nothing
sends the same motion, a pose after the answer to the last: what the sensor and its server take.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, ViewportSize, sync_playwright
from websockets.sync.client import ClientConnection, connect

from dotsim_ros.io.cores import available_core_count
from dotsim_ros.specification import load_sensor
from studies.run import expect_positive
from studies.timing import percentiles_ms

BROWSERS = ("chromium", "google-chrome")
WINDOW = ViewportSize(width=1280, height=800)
START_S = 300.0
MOVE_S = 1.0 / 60.0
DEEP_MM = 2.0
GOAL_MS = 100.0
STEP_M = 0.2e-3
"""How far the reader that draws nothing moves the indenter from pose to pose."""
SLIDE_STEPS = 20


def opened_address(server: subprocess.Popen[str]) -> str:
    """Return where the page is, once the server says so."""
    assert server.stdout is not None
    for line in server.stdout:
        if found := re.search(r"http://\S+", line):
            return found[0]
    raise RuntimeError("dotsim_ros live ended without a page")


def received(socket: ClientConnection) -> dict[str, Any]:
    """Return what the server's next message says, without its arrays, and ask for the next."""
    payload = socket.recv(timeout=START_S)
    assert isinstance(payload, bytes)
    socket.send("")
    length = int.from_bytes(payload[:4], "little")
    message: dict[str, Any] = json.loads(payload[4 : 4 + length])
    return message


def answered(address: str, seconds: float) -> list[float]:
    """Return the times in seconds from a pose to the skin that shows it, without a browser."""
    apex_m = load_sensor("densetact2").gel.bounds_m[1][2]
    lags_s: list[float] = []
    with connect(f"{address.replace('http', 'ws', 1).rstrip('/')}/socket") as socket:
        while (state := received(socket))["kind"] != "state" or state["busy"]:
            pass
        end_s = time.perf_counter() + seconds
        number = 0
        while time.perf_counter() < end_s:
            number += 1
            deep_m = min(number * STEP_M, 1e-3 * DEEP_MM)
            along_m = STEP_M * abs(number % (2 * SLIDE_STEPS) - SLIDE_STEPS)
            place = {"position_m": [along_m, 0.0, apex_m - deep_m], "quaternion_xyzw": [0, 0, 0, 1]}
            begun_s = time.perf_counter()
            socket.send(json.dumps({"do": "pose", "number": number, **place}))
            while (skin := received(socket))["kind"] != "skin" or skin["number"] != number:
                pass
            lags_s.append(time.perf_counter() - begun_s)
        socket.send(json.dumps({"do": "reset"}))
    return lags_s


def taken(page: Page) -> tuple[float, float]:
    """Return where the mouse holds the indenter."""
    box = page.locator("#scene").bounding_box()
    assert box is not None
    x = box["x"] + box["width"] / 2
    for y in np.arange(box["y"] + 5, box["y"] + box["height"], 5):
        page.mouse.move(x, y)
        if page.locator("#scene.over").count():
            page.mouse.down()
            return x, float(y)
    raise RuntimeError("no indenter under the mouse")


def drag(page: Page, seconds: float) -> tuple[float, list[float]]:
    """Return the rate in Hz at the end of a drag in contact, and its times in milliseconds."""
    x, y = taken(page)
    while float(page.locator("#motion").text_content() or 0.0) < DEEP_MM:
        y += 1.0
        page.mouse.move(x, y)
        page.wait_for_timeout(1e3 * MOVE_S)
    page.evaluate("lagsMs.length = 0")
    begun_s = time.perf_counter()
    while (past_s := time.perf_counter() - begun_s) < seconds:
        page.mouse.move(x + 25.0 * math.sin(2.0 * past_s), y + 4.0 * math.sin(5.0 * past_s))
        page.wait_for_timeout(1e3 * MOVE_S)
    rate = float(page.locator("#rate").text_content() or 0.0)
    page.mouse.up()
    return rate, page.evaluate("lagsMs")


def live(*, seconds: float = 15.0, screenshot: Path | None = None) -> dict[str, Any]:
    """From the mouse to the skin: how long the live page takes to show what a drag has moved.

    Args:
        seconds: of the drag.
        screenshot: file for a picture of the page.
    """
    expect_positive(seconds=seconds)
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise ValueError(f"none of {', '.join(BROWSERS)} is installed; install one of them")
    with tempfile.TemporaryDirectory() as recordings:
        server = subprocess.Popen(
            [
                *(sys.executable, "-m", "dotsim_ros.cli.main", "live"),
                *("--port", "0", "--out", recordings),
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            address = opened_address(server)
            alone_s = answered(address, seconds)
            rate, lags_ms = _dragged(address, browser, seconds, screenshot)
        finally:
            server.terminate()
            server.wait()
    lags = percentiles_ms(1e-3 * np.array(lags_ms))
    return {
        "cores": available_core_count(),
        "seconds": seconds,
        "drags": len(lags_ms),
        "frames_per_second": rate,
        **{f"drag_to_skin_{name}": value for name, value in lags.items()},
        "without_a_browser_p50_ms": percentiles_ms(alone_s)["p50_ms"],
        "goal_ms": GOAL_MS,
    }


def _dragged(
    address: str, browser: str, seconds: float, screenshot: Path | None
) -> tuple[float, list[float]]:
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=browser,
            # As a browser does where there is no graphics card: it draws WebGL, and it alone, by
            # SwiftShader. As root, in a container, there is no other sandbox.
            args=["--enable-unsafe-swiftshader", "--no-sandbox"],
        )
        page = opened.new_page(viewport=WINDOW)
        page.goto(address)
        page.locator("#indenter:enabled").wait_for(timeout=1e3 * START_S)
        figures = drag(page, seconds)
        if screenshot is not None:
            page.wait_for_timeout(1000)
            page.screenshot(path=screenshot)
        opened.close()
        return figures
