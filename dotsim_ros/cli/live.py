# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Open the live page: drag an indenter over the sensor in the browser, and watch what it feels.

The page is served to this machine alone, and loads nothing from outside. It shows the camera's
image, the indentation, the skin coloured by how far it has moved, and the force over time, records
presses as ROS 2 bags in OUT, and scrubs through any bag. With --attach it shows a running node
instead, by its topics, and publishes indenter/pose to it; that needs ROS 2. With --rerun it
shows the node in rerun's viewer (rerun.io), which runs already, in place of the page. Ctrl-C ends
it.

example:
  dotsim_ros live
  dotsim_ros live --sensor flat_pad --indenter cone --profile exact
  dotsim_ros live --attach --ros-args -r __ns:=/left_finger
  dotsim_ros live --attach --rerun rerun+http://127.0.0.1:9876/proxy
"""

from __future__ import annotations

import os
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dotsim_ros.cli._options import NoSeed, within

if TYPE_CHECKING:
    from dotsim_ros.geometry.indenter import Indenter
    from dotsim_ros.live.desk import LiveDesk

PORT = 8321
HIGHEST_PORT = 65535
SENSOR, INDENTER, PROFILE = "densetact2", "sphere_4mm", "realtime"


def run(
    *,
    port: Annotated[int, within(0, HIGHEST_PORT, int)] = PORT,
    sensor: str | None = None,
    indenter: str | None = None,
    profile: str | None = None,
    out: Path = Path("out/live"),
    open_page: Annotated[bool, Parameter(name="--open")] = False,
    attach: bool = False,
    node: str = "tactile_sim",
    rerun: str | None = None,
    ros_args: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True)] = (),
    seed: NoSeed = 0,
) -> int:
    """Serve the page until Ctrl-C.

    Args:
        port: of the page; 0 for any that is free.
        sensor: name below params/sensors or a YAML file, without it densetact2; the page's menu has
            the others.
        indenter: name below params/indenters, a YAML, STL, OBJ or PLY file, or a definition such as
            'sphere(radius_m=0.003)'; without it sphere_4mm.
        profile: exact, realtime or fast; without it realtime.
        out: folder of recorded bags.
        open_page: open the page in a browser.
        attach: show a running tactile_sim.
        node: its name.
        rerun: with --attach: URL of a running viewer, or an .rrd file that is written at the end.
        ros_args: namespace and remaps for --attach; last.
    """
    from dotsim_ros.io.extras import extra_needed

    if rerun is not None:
        if not attach:
            raise ValueError("--rerun shows the topics of a running node: give --attach with it")
        return _shown_in_rerun(rerun, ros_args)
    with extra_needed("the live page", "live"):
        import websockets  # noqa: F401
    from dotsim_ros.live.desk import LiveDesk
    from dotsim_ros.live.server import PageServer

    # What is wrong with the command is said before a page opens.
    if attach:
        if sensor is not None or profile is not None:
            raise ValueError("--sensor and --profile are the node's own parameters: set them there")
        show = _attached(indenter, node, ros_args)
    else:
        if ros_args:
            raise ValueError("--ros-args are for --attach: a sensor of this process has no topics")
        show = _simulated(sensor or SENSOR, indenter or INDENTER, profile or PROFILE)
    server = PageServer(port)
    desk = LiveDesk(out, server.publish)
    server.start(desk)
    try:
        print(f"open {server.url}", flush=True)
        if open_page and _has_screen():
            webbrowser.open(server.url)
        return show(desk)
    finally:
        desk.close()
        server.stop()


def _has_screen() -> bool:
    """Return whether a browser can open; one in the terminal would take that over, and shows no
    page like this."""
    return not sys.platform.startswith("linux") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def _simulated(sensor: str, given: str, profile: str) -> Callable[[LiveDesk], int]:
    """Return what presses a sensor of this process until Ctrl-C."""
    from dotsim_ros.io.files import shipped_names
    from dotsim_ros.nodes.live_page.simulated import SimulatedSubject
    from dotsim_ros.nodes.tactile_sim.profiles import PROFILES
    from dotsim_ros.specification import load_sensor

    if profile not in PROFILES:
        raise ValueError(f"--profile is {profile!r}, expected one of {', '.join(PROFILES)}")
    first = load_sensor(sensor)
    sensors = {name: load_sensor(name) for name in shipped_names("sensors")}
    sensors[first.name] = first
    name, indenter = _indenter(given)
    names = list(dict.fromkeys([*shipped_names("indenters"), name]))

    def show(desk: LiveDesk) -> int:
        subject = SimulatedSubject(
            desk,
            sensors,
            {name: indenter},
            sensor=first.name,
            indenters=names,
            profile=profile,
        )
        desk.attend(subject)
        subject.start()
        try:
            threading.Event().wait()
        finally:
            subject.stop()
        return 0

    return show


def _need_ros() -> None:
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "--attach needs ROS 2, which is not there: source /opt/ros/jazzy, or "
            "pip install 'dotsim_ros[ros,live]'"
        ) from error


def _shown_in_rerun(place: str, ros_args: Sequence[str]) -> int:
    """Show a running node in rerun until Ctrl-C."""
    _need_ros()
    from dotsim_ros.nodes.common.spin import run_node
    from dotsim_ros.nodes.live_page.rerun_view import RerunView
    from dotsim_ros.view.rerun_log import RerunLog, recording_at

    with recording_at(place) as recording:
        log = RerunLog(recording)
        print(f"shown at {place}", flush=True)
        return run_node(lambda: RerunView(log), arguments=["--ros-args", *ros_args])


def _attached(given: str | None, node: str, ros_args: Sequence[str]) -> Callable[[LiveDesk], int]:
    """Return what shows a running node until Ctrl-C."""
    _need_ros()
    from dotsim_ros.io.files import shipped_names
    from dotsim_ros.nodes.common.spin import run_node
    from dotsim_ros.nodes.live_page.attachment import LiveAttachment

    drawn = None if given is None else _indenter(given)[1]

    def show(desk: LiveDesk) -> int:
        return run_node(
            lambda: LiveAttachment(
                desk, node_name=node, indenters=shipped_names("indenters"), indenter=drawn
            ),
            arguments=["--ros-args", *ros_args],
        )

    return show


def _indenter(given: str) -> tuple[str, Indenter]:
    """Return an indenter and what the page calls it.

    Raises:
        FileNotFoundError, ValueError: there is none such.
    """
    from dataclasses import replace

    from dotsim_ros.geometry.indenter import is_definition, load_indenter

    found = load_indenter(given)
    name = found.name if is_definition(given) else Path(given).stem
    return name, replace(found, name=name)
