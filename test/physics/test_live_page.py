# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live page: a sensor that is really solved, a server that really listens, a real browser."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs pip install '.[live]'")

from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from dotsim_ros import Pose, load_indenter, load_sensor
from dotsim_ros.cli.main import main
from dotsim_ros.data.bag import BagReader
from dotsim_ros.data.trajectory import Topics, read_trajectory
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.live.desk import LiveDesk
from dotsim_ros.live.server import PageServer
from dotsim_ros.nodes.live_page.simulated import SimulatedSubject
from dotsim_ros.specification import SensorSpecification
from msg_adapters import decode_image

BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
WINDOW = {"width": 1000, "height": 640}
PATIENCE_S = 300.0
"""The first frame waits for the kernels to be compiled."""
PRESSED_MM = 0.5
APEX_M = 0.01575


def coarse(name: str, grid_spacing_m: float) -> SensorSpecification:
    sensor = load_sensor(name)
    solver = replace(sensor.solver, refined=False, grid_spacing_m=grid_spacing_m)
    return replace(sensor, solver=solver)


def coarse_subject(desk: LiveDesk) -> SimulatedSubject:
    sensors = {"densetact2": coarse("densetact2", 4.8e-3), "flat_pad": coarse("flat_pad", 2e-3)}
    own = {"sphere_4mm": load_indenter("sphere_4mm")}
    return SimulatedSubject(
        desk, sensors, own, sensor="densetact2", indenters=["cone", "sphere_4mm"]
    )


def head_of(payload: bytes) -> tuple[dict[str, Any], bytes]:
    """Return what a payload says, and the arrays behind it."""
    length = int.from_bytes(payload[:4], "little")
    return json.loads(payload[4 : 4 + length]), payload[4 + length :]


class Live:
    """A sensor on a page, as `dotsim_ros live` makes it, of a coarse gel."""

    def __init__(self, recordings: Path) -> None:
        self.recordings = recordings
        self.server = PageServer(0)
        self.desk = LiveDesk(recordings, lambda kind, payload: self.server.publish(kind, payload))
        self.subject = coarse_subject(self.desk)
        self.desk.attend(self.subject)
        self.server.start(self.desk)
        self.subject.start()

    def restart_server(self) -> None:
        port = self.server.port
        self.server.stop()
        self.server = PageServer(port)
        self.server.start(self.desk)

    def close(self) -> None:
        self.subject.stop()
        self.desk.close()
        self.server.stop()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    page = Live(tmp_path_factory.mktemp("recordings"))
    yield page
    page.close()


class Client:
    """A page without a browser."""

    def __init__(self, live: Live) -> None:
        self._stack = ExitStack()
        self._socket: ClientConnection = self._stack.enter_context(
            connect(f"ws://127.0.0.1:{live.server.port}/socket")
        )
        self.newest: dict[str, dict[str, Any]] = {}

    def send(self, **order: Any) -> None:
        self._socket.send(json.dumps(order))

    def wait(self, is_reached: Callable[[dict[str, Any]], Any], kind: str) -> dict[str, Any]:
        """Return the first payload of a kind for which something holds."""
        end_s = time.monotonic() + PATIENCE_S
        while kind not in self.newest or not is_reached(self.newest[kind]):
            payload = self._socket.recv(timeout=end_s - time.monotonic())
            assert isinstance(payload, bytes)
            self._socket.send("")
            message, arrays = head_of(payload)
            for name, offset, size, form in message["parts"]:
                content = arrays[offset:][:size]
                message[name] = content if form == "jpeg" else np.frombuffer(content, form)
            self.newest[message["kind"]] = message
        return self.newest[kind]

    def ready(self) -> None:
        self.wait(lambda state: state["can_press"] and not state["busy"], "state")

    def press(self, depth_m: float, number: int) -> dict[str, Any]:
        position = [0.0, 0.0, APEX_M - depth_m]
        self.send(do="pose", position_m=position, quaternion_xyzw=[0, 0, 0, 1], number=number)
        return self.wait(lambda skin: skin["number"] == number and not skin["is_behind"], "skin")

    def notice(self, before: int) -> str:
        state = self.wait(lambda state: state["notice_number"] > before, "state")
        return str(state["notice"])

    def close(self) -> None:
        self._stack.close()


@pytest.fixture
def client(live: Live) -> Iterator[Client]:
    page = Client(live)
    page.ready()
    yield page
    page.close()


def test_a_pose_moves_the_skin_and_a_pose_beyond_the_gel_leaves_it(client: Client) -> None:
    rest = client.wait(lambda scene: True, "scene")["rest"].reshape(-1, 3)
    skin = client.press(0.001, 1)
    moved_m = np.linalg.norm(skin["skin"].reshape(-1, 3) - rest, axis=1).max()
    assert moved_m == pytest.approx(0.001, abs=0.2e-3)
    assert skin["force_n"][2] > 0.05
    # The camera has seen it, too.
    client.wait(lambda picture: picture["stamp_s"] >= skin["stamp_s"], "picture")
    before = client.newest["state"]["notice_number"]
    client.send(do="pose", position_m=[0, 0, 0.001], quaternion_xyzw=[0, 0, 0, 1], number=2)
    assert "deep" in client.notice(before)
    assert np.array_equal(client.newest["skin"]["skin"], skin["skin"])
    assert client.press(-0.001, 3)["force_n"] == [0.0, 0.0, 0.0]


def test_the_indentation_is_along_the_axis_on_a_scale_that_grows_until_the_press_is_over(
    client: Client, live: Live
) -> None:
    def pressed(depth_m: float, number: int) -> dict[str, Any]:
        stamp_s = client.press(depth_m, number)["stamp_s"]
        return client.wait(lambda picture: picture["stamp_s"] >= stamp_s, "picture")

    pressed(-0.001, 4)
    client.send(do="record", name="depths")
    client.wait(lambda state: state["recording"], "state")
    picture = pressed(0.0013, 5)
    assert picture["indentation_end_m"] == pytest.approx(1.5e-3)
    shown = cv2.imdecode(np.frombuffer(picture["indentation"], np.uint8), cv2.IMREAD_COLOR)
    # The apex is in the middle of the image, where the ray is the axis.
    middle = shown[shown.shape[0] // 2, shown.shape[1] // 2, ::-1].astype(float)
    colours = picture["colours"].reshape(256, 3)
    indentation_m = 1.5e-3 / 255 * np.argmin(np.linalg.norm(colours - middle, axis=1))
    rest_m, skin_m = (
        client.newest[kind][name].reshape(-1, 3)
        for kind, name in (("scene", "rest"), ("skin", "skin"))
    )
    assert indentation_m == pytest.approx((rest_m - skin_m)[:, 2].max(), abs=0.05e-3)
    assert pressed(0.0007, 6)["indentation_end_m"] == pytest.approx(1.5e-3)
    assert pressed(-0.001, 7)["indentation_end_m"] == pytest.approx(0.5e-3)
    client.send(do="stop")
    client.wait(lambda state: state["recording"] is None, "state")

    camera = Camera.from_specification(load_sensor("densetact2").camera)
    with BagReader(live.recordings / "depths") as bag:
        depth_m = [decode_image(each.message()) for each in bag.messages("/depth/image")][-1]
    across, down = np.rint(camera.project(rest_m).T / 2).astype(int)
    optical_m = camera.to_optical(rest_m)
    height, width = depth_m.shape
    # Rays of 30 to 60 degrees from the axis: a range would be at least 1.15 times the depth.
    share = optical_m[:, 2] / np.linalg.norm(optical_m, axis=1)
    is_seen = (share > 0.5) & (share < 0.87) & (across < width) & (down < height)
    is_seen &= (across >= 0) & (down >= 0)
    ratio = depth_m[down[is_seen], across[is_seen]] / optical_m[is_seen, 2]
    assert np.isfinite(ratio).sum() > 1000
    assert np.nanmax(np.abs(ratio - 1.0)) < 0.05


def test_another_sensor_is_pressed_in_the_same_process(client: Client) -> None:
    state = client.newest["state"]
    assert state["sensors"] == ["densetact2", "flat_pad"]
    assert set(state["profiles"]) == {"exact", "realtime", "fast"}
    assert all(state["profiles"].values())
    for number, name in enumerate(("flat_pad", "densetact2"), 51):
        client.send(do="sensor", name=name)
        client.wait(lambda state, name=name: state["sensor"] == name and not state["busy"], "state")
        scene = client.wait(lambda scene: True, "scene")
        apex_m = float(scene["rest"].reshape(-1, 3)[:, 2].max())
        client.wait(lambda history: history["time"].size < 2, "history")
        assert apex_m == pytest.approx(load_sensor(name).gel.bounds_m[1][2], abs=1e-5)
        client.press(APEX_M - apex_m + 0.0005, number)
        assert client.newest["skin"]["force_n"][2] > 0.01


def test_an_order_at_the_very_first_moment_is_followed(tmp_path: Path) -> None:
    followed = threading.Event()

    def publish(_kind: str, payload: bytes) -> None:
        message, _ = head_of(payload)
        if message.get("can_press"):
            subject.move(Pose(np.array([0.0, 0.0, APEX_M])), 7)
        elif message.get("number") == 7:
            followed.set()

    desk = LiveDesk(tmp_path, publish)
    subject = coarse_subject(desk)
    subject.start()
    try:
        assert followed.wait(PATIENCE_S)
    finally:
        subject.stop()
        desk.close()


def test_another_indenter_and_profile_are_taken_up(client: Client) -> None:
    client.send(do="indenter", name="cone")
    client.wait(lambda state: state["indenter"] == "cone" and not state["busy"], "state")
    cone = client.press(0.001, 11)["force_n"][2]
    client.send(do="profile", name="exact")
    client.wait(lambda state: state["profile"] == "exact" and not state["busy"], "state")
    client.send(do="indenter", name="sphere_4mm")
    client.wait(lambda state: state["indenter"] == "sphere_4mm" and not state["busy"], "state")
    assert client.press(0.001, 12)["force_n"][2] > cone
    client.send(do="profile", name="realtime")
    client.wait(lambda state: state["profile"] == "realtime" and not state["busy"], "state")


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ("no order", "Expecting value"),
        ('{"do": "fly"}', "'fly'.*expected a mapping with 'do'"),
        ('{"do": "pose", "position_m": [0, 0, NaN]}', "position_m.*expected 3 finite numbers"),
        ('{"do": "indenter", "name": "spoon"}', "'spoon', expected one of cone, sphere_4mm"),
        ('{"do": "sensor", "name": "spoon"}', "'spoon', expected one of densetact2, flat_pad"),
        ('{"do": "profile", "name": "slow"}', "'slow', expected one of exact, realtime, fast"),
        ('{"do": "record", "name": "../x"}', "'../x', expected at most 100 letters"),
        ('{"do": "stop"}', "nothing is being recorded"),
        ('{"do": "scrub", "index": 3}', "no bag is shown"),
        ('{"do": "load", "path": "none"}', "no bag at .*none"),
        (json.dumps({"do": "load", "path": __file__}), "is no ROS 2 bag that can be read"),
    ],
)
def test_a_wrong_order_is_answered_in_words(client: Client, order: str, words: str) -> None:
    before = client.newest["state"]["notice_number"]
    client._socket.send(order)
    assert re.search(words, client.notice(before))


def test_pages_of_other_sites_are_refused(live: Live) -> None:
    for options in ({"origin": "http://elsewhere.example"}, {"host": "127.0.0.2"}):
        name = options.pop("host", "127.0.0.1")
        with (
            pytest.raises(InvalidStatus) as caught,
            connect(
                f"ws://{name}:{live.server.port}/socket",
                sock=socket.create_connection(("127.0.0.1", live.server.port)),
                **options,  # type: ignore[arg-type]
            ),
        ):
            pass
        assert caught.value.response.status_code == 403


def test_wrong_commands_are_refused_in_one_line(
    live: Live, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(*arguments: str) -> str:
        assert main(["live", *arguments]) == 1
        return capsys.readouterr().err

    port = str(live.server.port)
    assert f"port {port} cannot be used: another program listens there" in said("--port", port)
    assert "no sensor is named 'densetact9' (did you mean 'densetact2'?), expected one of" in said(
        "--sensor", "densetact9"
    )
    assert "no indenter is named 'spoon', expected one of box_edge," in said("--indenter", "spoon")
    assert "--profile is 'slow', expected one of exact, realtime, fast" in said("--profile", "slow")
    monkeypatch.setitem(sys.modules, "websockets", None)
    assert "pip install 'dotsim_ros[live]'" in said()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("needs chromium or google-chrome: apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="needs pip install playwright")
    with api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=BROWSER,
            # Graphics without a card; and in a container root has no other sandbox.
            args=[
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                *(["--no-sandbox"] if os.geteuid() == 0 else []),
            ],
        )
        yield opened
        opened.close()


class Tab:
    """The page in a browser; keeps what its console says and what it asks for elsewhere."""

    def __init__(self, browser: Any, live: Live) -> None:
        self.page = browser.new_page(viewport=WINDOW)
        self.page.set_default_timeout(1e3 * PATIENCE_S)
        self.complaints: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", self._on_request)
        self.page.goto(live.server.url)
        self.find("#indenter:enabled")

    def _on_request(self, request: Any) -> None:
        if not request.url.startswith(("http://127.0.0.1:", "blob:http://127.0.0.1:", "data:")):
            self.complaints.append(f"asks for {request.url}")

    def find(self, selector: str, **options: Any) -> Any:
        found = self.page.locator(selector)
        found.wait_for(**options)
        return found

    def motion_mm(self) -> float:
        return float(self.page.locator("#motion").text_content())

    def rate(self) -> str:
        return str(self.page.locator("#rate").text_content())

    def wait(self, is_reached: Callable[[], Any], what: str) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not is_reached():
            assert time.monotonic() < end_s, f"waited for {what}"
            self.page.wait_for_timeout(50)

    def image_width_px(self) -> int:
        return int(self.page.locator("#image").evaluate("image => image.naturalWidth"))

    def drag_down(self, pixels: int) -> None:
        """Drag the indenter, which is found by the shape of the pointer, onto the skin."""
        box = self.page.locator("#scene").bounding_box()
        x = box["x"] + box["width"] / 2
        for y in np.arange(box["y"] + 5, box["y"] + box["height"], 8):
            self.page.mouse.move(x, y)
            if self.page.locator("#scene.over").count():
                break
        else:
            raise AssertionError("no indenter under the mouse")
        self.page.mouse.down()
        for step in range(1, 9):
            self.page.mouse.move(x, y + pixels * step / 8)
        self.page.mouse.up()


def test_a_drag_moves_the_skin_in_every_tab_and_a_tab_comes_back(
    live: Live, client: Client, browser: Any
) -> None:
    client.press(-0.002, 21)
    tab, other = Tab(browser, live), Tab(browser, live)
    tab.page.click("#reset")
    tab.page.get_by_text("indenter away").wait_for()
    assert tab.motion_mm() == 0.0
    tab.drag_down(60)
    for each in (tab, other):
        each.wait(lambda each=each: each.motion_mm() > PRESSED_MM, "a skin that has moved")
        # The picture follows the skin, and a browser unpacks it in its own time.
        each.wait(lambda each=each: each.image_width_px() == 640, "a picture of 640 pixels")
    assert tab.page.evaluate("lagsMs.length") > 0
    # Frames are sent on a change alone.
    for each in (tab, other):
        each.wait(lambda each=each: each.rate() == "idle", "no frames")
    assert tab.complaints == other.complaints == []
    # A tab that slept or lost the network has no connection any more when it comes back.
    live.restart_server()
    for each in (tab, other):
        each.find("body[data-connected=yes] #indenter:enabled")
        each.wait(lambda each=each: each.motion_mm() > PRESSED_MM, "the skin as it was")
        each.page.close()


def test_a_recorded_press_is_a_bag_that_the_page_scrubs_through(
    live: Live, client: Client, browser: Any
) -> None:
    client.press(-0.002, 31)
    tab = Tab(browser, live)
    tab.page.fill("#name", "one")
    tab.page.click("#record")
    tab.find("#record.on")
    for number, depth_m in enumerate((0.0005, 0.001, 0.0015), 32):
        client.press(depth_m, number)
    tab.wait(lambda: tab.motion_mm() > 1.2, "a deep press")
    tab.page.click("#record")
    tab.find("#record:not(.on)")
    bag = live.recordings / "one"
    recorded = read_trajectory(
        bag,
        topics=Topics("/indenter/state", "/wrench", "/points", "/image_raw/compressed"),
    )
    assert recorded.wrench is not None
    assert recorded.pose is not None
    assert recorded.wrench.force_n[-1, 2] == recorded.wrench.force_n[:, 2].max() > 0.1

    tab.page.fill("#path", "one")
    tab.page.click("#load")
    scrub = tab.find("#scrub")
    tab.wait(lambda: tab.motion_mm() < PRESSED_MM + 0.1, "the first moment")
    scrub.press("End")
    tab.wait(lambda: tab.motion_mm() > 1.2, "the last moment")
    # The bag tells the shape.
    assert client.wait(lambda scene: True, "scene")["indenter"].size > 0
    tab.page.click("#live")
    tab.find("#playback", state="hidden")
    assert tab.complaints == []
    tab.page.close()
