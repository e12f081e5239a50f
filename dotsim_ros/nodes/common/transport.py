# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How DDS transports images out of a process, and whether it leaves this machine."""

from __future__ import annotations

import os

from dotsim_ros.io.files import parameter_path

PROFILE_FILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables that name a profile of Fast DDS: version 2, of ROS 2 Jazzy, reads the first alone."""
USER_SETTINGS = (*PROFILE_FILES, "FASTDDS_BUILTIN_TRANSPORTS")
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def carry_images() -> None:
    """Make Fast DDS hold whole images in shared memory, unless the user has configured it.

    Acts on what is started afterwards, so call it before `rclpy.init`; other middlewares ignore it.
    """
    if not _is_configured():
        os.environ[PROFILE_FILES[0]] = str(parameter_path("fastdds.xml"))


def stay_local() -> None:
    """Keep DDS on this machine: no socket is bound to another address than 127.0.0.1.

    Acts as `carry_images`, and holds images too. Fast DDS that the user has configured is left as
    it is; other middlewares look for nodes on this machine only, unless the user says where.
    """
    if not os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps"):
        os.environ.setdefault(RANGE, "LOCALHOST")
    elif not _is_configured():
        os.environ[PROFILE_FILES[0]] = str(parameter_path("fastdds_localhost.xml"))
        # With LOCALHOST, ROS adds a transport of its own, whose sockets are open to all.
        os.environ[RANGE] = "SYSTEM_DEFAULT"


def _is_configured() -> bool:
    return any(os.environ.get(name) for name in USER_SETTINGS)
