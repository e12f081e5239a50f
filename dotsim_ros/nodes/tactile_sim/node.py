# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`tactile_sim`: stands where an optical tactile sensor's driver would.

An indenter's pose (of a topic, odometry or TF) or velocity goes in; images, depth, the skin and the
wrench come out.
"""

from __future__ import annotations

from dotsim_ros.nodes.common.declare import declare_fields, follow, read
from dotsim_ros.nodes.common.life_cycle import LifeCycle
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.common.transport import carry_images
from dotsim_ros.nodes.tactile_sim.configured_sensor import ConfiguredSensor
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters


class TactileSim(WorkingNode):
    """The node; parameters, topics, services and states as docs/run.md lists them."""

    def __init__(self) -> None:
        super().__init__("tactile_sim")
        self._life_cycle = LifeCycle(self, self)
        self._sensor: ConfiguredSensor | None = None
        declare_fields(self, TactileSimParameters)
        follow(self, self._settings, lambda changed: self._configured().change(changed))
        self._life_cycle.start()

    def begin(self) -> None:
        """Activate the node, where it starts by itself."""
        self._life_cycle.begin()

    def configure(self) -> None:
        """Load the sensor, and make its simulation, topics and services."""
        self._sensor = ConfiguredSensor(self, read(self, TactileSimParameters).prefixed())

    def activate(self) -> None:
        """Start the frames."""
        self._configured().activate()

    def deactivate(self) -> None:
        """Stop the frames."""
        self._configured().deactivate()

    def clean_up(self) -> None:
        """Let go of the sensor; the parameters are read again when the node is configured again."""
        self._sensor = None

    def _configured(self) -> ConfiguredSensor:
        assert self._sensor is not None, "the state machine activates only what is configured"
        return self._sensor

    def _settings(self) -> TactileSimParameters | None:
        return None if self._sensor is None else self._sensor.settings


def main() -> int:
    """Run the node until it is stopped; return the exit status."""
    carry_images()
    return run_node(TactileSim)


if __name__ == "__main__":
    raise SystemExit(main())
