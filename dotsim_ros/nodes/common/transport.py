"""How DDS transports images out of a process."""

from __future__ import annotations

import os

from dotsim_ros.files import parameter_path

USER_SETTINGS = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
)


def carry_images() -> None:
    """Make Fast DDS hold whole images in shared memory, unless the user has configured it.

    Acts on what is started afterwards, so call it before `rclpy.init`; other middlewares ignore it.
    """
    if not any(os.environ.get(name) for name in USER_SETTINGS):
        os.environ[USER_SETTINGS[0]] = str(parameter_path("fastdds.xml"))
