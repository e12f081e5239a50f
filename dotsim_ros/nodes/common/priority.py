# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The priority of a process that has deadlines. Needs no ROS."""

from __future__ import annotations

import os


def take_priority(priority: int) -> None:
    """Let every thread of this process go before all that have no priority; 0: nothing.

    Threads that are started later take it over.

    Raises:
        ValueError: the system does not allow it.
    """
    if priority == 0:
        return
    try:
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(priority))
    except PermissionError as error:
        raise ValueError(
            f"realtime_priority {priority} is not allowed ({error}): let the system allow it "
            "(rtprio in /etc/security/limits.conf, LimitRTPRIO of systemd), or leave it at 0"
        ) from error
