# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_closed_loop`: `xarm_sim`, `tactile_sim` and `tactile_policy` in one process.

The nodes are the same as those of their own executables, with the same names, parameters, services
and topics: `xarm_sim --help` and so on list them. Messages between them are passed on as they are;
other nodes receive them over DDS.
"""

from __future__ import annotations

import sys

from dotsim_ros.nodes.common.local_topics import composed
from dotsim_ros.nodes.common.spin import run_nodes
from dotsim_ros.nodes.common.transport import carry_images
from dotsim_ros.nodes.tactile_policy.node import SWITCH_INTERVAL_S, TactilePolicy
from dotsim_ros.nodes.tactile_sim.node import TactileSim
from dotsim_ros.nodes.xarm_sim.node import XarmSim


def main() -> int:
    """Run the nodes until one of them is stopped; return the exit status."""
    carry_images()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    with composed():
        return run_nodes([XarmSim, TactilePolicy, TactileSim])


if __name__ == "__main__":
    raise SystemExit(main())
