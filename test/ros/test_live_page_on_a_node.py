# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_ros live --attach`: the page shows a running node of a namespace, and presses it."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

pytest.importorskip("websockets", reason="needs pip install '.[live]'")

from harness import APEX_M, PATIENCE_S, LockstepPress, running, sensor
from websockets.sync.client import ClientConnection, connect

NAMESPACE = "/left_finger"
CODE = """
from dotsim_ros.cli.main import main
given = ["live", "--attach", "--port", "0", "--out", {out!r}]
raise SystemExit(main([*given, "--ros-args", "-r", "__ns:={namespace}"]))
"""


def heard(
    socket: ClientConnection, kind: str, is_wanted: Callable[[dict[str, Any]], bool]
) -> dict[str, Any]:
    """Return the header of the first payload of a kind that is wanted."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        payload = socket.recv(timeout=end_s - time.monotonic())
        assert isinstance(payload, bytes)
        socket.send("")
        header = json.loads(payload[4 : 4 + int.from_bytes(payload[:4], "little")])
        if header["kind"] == kind and is_wanted(header):
            return dict(header)


def test_a_page_presses_a_running_node_and_shows_what_it_publishes(tmp_path: Path) -> None:
    node = {"grid_spacing_m": 0.0048, "diagnostics_period_s": 0.1, "frame_prefix": "left_"}
    with (
        running(parameters=node, arguments=["-r", f"__ns:={NAMESPACE}"]),
        running(
            code=CODE.format(out=str(tmp_path), namespace=NAMESPACE), ready="open http"
        ) as page,
    ):
        found = re.search(r"http://127.0.0.1:(\d+)/", page.log)
        assert found is not None
        # Those of DDS are kept on this machine by the tests' settings, the page's by itself.
        sockets = psutil.Process(page.process.pid).net_connections("inet")
        assert {each.laddr.ip for each in sockets} == {"127.0.0.1"}
        listening = [each.laddr.port for each in sockets if each.status == psutil.CONN_LISTEN]
        assert listening == [int(found[1])]
        with connect(f"ws://127.0.0.1:{found[1]}/socket") as socket:
            # The profile is told by the node's diagnostics, the rest by its frames: in any order,
            # and a state that is heard is not sent again.
            state = heard(
                socket,
                "state",
                lambda state: state["profile"] and state["can_press"] and not state["busy"],
            )
            assert state["title"] == f"{NAMESPACE}/tactile_sim"
            assert "exact" in state["profiles"][state["profile"]]
            position_m = [0.0, 0.0, APEX_M - 0.001]
            pose = {"do": "pose", "position_m": position_m, "quaternion_xyzw": [0, 0, 0, 1]}
            socket.send(json.dumps(pose))
            heard(socket, "skin", lambda skin: bool(skin["force_n"]) and skin["force_n"][2] > 0.05)
            deep = {**pose, "position_m": [0.0, 0.0, APEX_M - 0.009]}
            socket.send(json.dumps(deep))
            heard(socket, "state", lambda state: "press less deep" in state["notice"])
            # Against the depth of the frame that showed the skin at rest.
            picture = heard(
                socket, "picture", lambda picture: picture.get("indentation_end_m", 0.0) > 0.6e-3
            )
            assert picture["indentation_end_m"] < 2e-3
            assert {part[0] for part in picture["parts"]} == {"image", "indentation", "colours"}
            socket.send(json.dumps({"do": "indenter", "name": "cone"}))
            heard(socket, "state", lambda state: state["indenter"] == "cone")
            socket.send(json.dumps({"do": "away"}))
            told = heard(socket, "state", lambda state: "cannot be taken away" in state["notice"])
            assert told["can_press"]
        assert page.interrupt() == 0


SEEN_BYTES = 2_000_000
RERUN_CODE = """
from dotsim_ros.cli.main import main
raise SystemExit(main(["live", "--attach", "--rerun", {out!r}]))
"""


def test_rerun_shows_what_a_running_node_publishes(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the extra rerun: pip install '.[rerun]'")
    reading = pytest.importorskip("rerun.chunk", reason="an older rerun cannot read its files")
    out = tmp_path / "live.rrd"
    with (
        sensor(clock="lockstep", grid_spacing_m=0.0048) as (_, client),
        running(code=RERUN_CODE.format(out=str(out)), ready="shown at") as view,
    ):
        press = LockstepPress(client)
        # The node and the view have met when images come; what is not whole has another name yet.
        (part,) = tmp_path.glob(".part.*/live.rrd")
        while part.stat().st_size < SEEN_BYTES:
            press.run()
        assert view.interrupt() == 0
    forces_n = {
        stamp_ns: force_n
        for chunk in reading.RrdReader(out).stream().to_chunks()
        if chunk.entity_path == "/wrench/force_n" and not chunk.is_static
        for stamp_ns, force_n in zip(
            chunk.to_record_batch()["stamp"].to_numpy().astype(int),
            chunk.to_record_batch()["Scalars:scalars"].to_pylist(),
            strict=True,
        )
    }
    assert forces_n
    for stamp_ns, force_n in forces_n.items():
        assert force_n == list(client.frames[stamp_ns].force_n())
