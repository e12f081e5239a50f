# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Open the live page: drag an indenter over the sensor in the browser, and watch what it feels.

The page is served to this machine alone, and loads nothing from outside. It shows the camera's
image, the indentation, the skin coloured by how far it has moved, and the force over time, records
presses as ROS 2 bags in OUT, and scrubs through any bag. With --attach it shows a running node
instead, by its topics, and publishes indenter/pose to it; that needs ROS 2. Ctrl-C ends it.

example:
  dotsim_ros live
  dotsim_ros live --sensor flat_pad --indenter cone --profile exact
  dotsim_ros live --attach --ros-args -r __ns:=/left_finger
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dotsim_ros.geometry.indenter import Indenter
    from dotsim_ros.live.desk import LiveDesk

PORT = 8321
HIGHEST_PORT = 65535
SENSOR, INDENTER, PROFILE = "densetact2", "sphere_4mm", "realtime"


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text[:6]) <= HIGHEST_PORT):
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 0 to {HIGHEST_PORT}")
    return int(text)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("--port", type=_port, default=PORT, help=f"0: any that is free ({PORT})")
    parser.add_argument(
        "--sensor",
        help=f"name below params/sensors or a YAML file ({SENSOR}); the page's menu has the others",
    )
    parser.add_argument(
        "--indenter",
        help="name below params/indenters, a YAML, STL, OBJ or PLY file, or a definition such as "
        f"'sphere(radius_m=0.003)' ({INDENTER})",
    )
    parser.add_argument("--profile", help=f"exact, realtime or fast ({PROFILE})")
    parser.add_argument(
        "--out", type=Path, default=Path("out/live"), help="folder of recorded bags (out/live)"
    )
    parser.add_argument("--open", action="store_true", help="open the page in a browser")
    parser.add_argument("--attach", action="store_true", help="show a running tactile_sim")
    parser.add_argument("--node", default="tactile_sim", help="its name (tactile_sim)")
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="...",
        help="namespace and remaps for --attach; last",
    )
    parser.add_argument("--seed", type=int, default=0, help="accepted; nothing here is random")


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    try:
        import websockets  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "the live page needs the package websockets, which is not installed: "
            "pip install 'dotsim_ros[live]'"
        ) from error
    from dotsim_ros.live.desk import LiveDesk
    from dotsim_ros.live.server import PageServer

    # What is wrong with the command is said before a page opens.
    show = (_attached if arguments.attach else _simulated)(arguments)
    server = PageServer(arguments.port)
    desk = LiveDesk(arguments.out, server.publish)
    server.start(desk)
    try:
        print(f"open {server.url}", flush=True)
        if arguments.open and _has_screen():
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


def _simulated(arguments: argparse.Namespace) -> Callable[[LiveDesk], int]:
    """Return what presses a sensor of this process until Ctrl-C."""
    from dotsim_ros.io.files import shipped_names
    from dotsim_ros.nodes.live_page.simulated import SimulatedSubject
    from dotsim_ros.nodes.tactile_sim.profiles import PROFILES
    from dotsim_ros.specification import load_sensor

    if arguments.ros_args:
        raise ValueError("--ros-args are for --attach: a sensor of this process has no topics")
    profile = arguments.profile or PROFILE
    if profile not in PROFILES:
        raise ValueError(f"--profile is {profile!r}, expected one of {', '.join(PROFILES)}")
    first = load_sensor(arguments.sensor or SENSOR)
    sensors = {name: load_sensor(name) for name in shipped_names("sensors")}
    sensors[first.name] = first
    name, indenter = _indenter(arguments.indenter or INDENTER)
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


def _attached(arguments: argparse.Namespace) -> Callable[[LiveDesk], int]:
    """Return what shows a running node until Ctrl-C."""
    if arguments.sensor is not None or arguments.profile is not None:
        raise ValueError("--sensor and --profile are the node's own parameters: set them there")
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "--attach needs ROS 2, which is not there: source /opt/ros/jazzy, or "
            "pip install 'dotsim_ros[ros,live]'"
        ) from error
    from dotsim_ros.io.files import shipped_names
    from dotsim_ros.nodes.common.spin import run_node
    from dotsim_ros.nodes.live_page.attachment import LiveAttachment

    drawn = None if arguments.indenter is None else _indenter(arguments.indenter)[1]

    def show(desk: LiveDesk) -> int:
        return run_node(
            lambda: LiveAttachment(
                desk, node_name=arguments.node, indenters=shipped_names("indenters"), indenter=drawn
            ),
            arguments=["--ros-args", *arguments.ros_args],
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
