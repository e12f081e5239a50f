# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real nodes over real DDS, in a domain of this run's own and on this machine only."""

import os
import sys
import tempfile
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros,test]'")

# Modules of this folder that are no tests.
sys.path.insert(0, str(Path(__file__).parent))

from domains import take_domain

from dotsim_ros.nodes.common.transport import USER_SETTINGS, stay_local

os.environ["ROS_DOMAIN_ID"] = str(take_domain())
os.environ["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
# Whatever the shell configured: `stay_local` leaves that as it is, and its sockets may be open.
for name in USER_SETTINGS:
    os.environ.pop(name, None)
stay_local()
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp(prefix="dotsim_ros_log_"))
TIMED = {
    "test_closed_loop",
    "test_drop_in",
    "test_realtime",
    "test_tactile_policy",
    "test_xarm_sim",
}
"""Files whose nodes must keep times: no other test runs next to theirs."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.stem in TIMED and item.path.parent == Path(__file__).parent:
            item.add_marker("timed")
