# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether another node publishes the same: two sensors that were started under one name."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node

ADVICE = (
    "give each a namespace (-r __ns:=/left, namespace:=left of a launch file), or topics of its own"
)


def duplicate_publishers(node: Node, topics: Sequence[str]) -> str:
    """Return who else publishes a node's topics, in one line; empty where nobody does.

    Args:
        node: that publishes each of them once.
        topics: names as they are after remaps.
    """
    for topic in topics:
        if node.count_publishers(topic) < 2:
            continue
        publishers = node.get_publishers_info_by_topic(topic)
        names = sorted(f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in publishers)
        return f"{topic} has {len(names)} publishers ({', '.join(names)}): {ADVICE}"
    return ""
