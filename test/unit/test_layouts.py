# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The layouts for RViz and Foxglove: whole, and of topics that the sensor and the player have."""

import json

import yaml

from dotsim_ros.data.trajectory import BASE_FRAME
from dotsim_ros.io.files import parameter_path

TOPICS = {"/image_raw", "/depth/image", "/points", "/wrench", "/indenter/pose"}


def test_rviz_shows_every_topic_in_the_base_frame():
    layout = yaml.safe_load(parameter_path("rviz/dotsim.rviz").read_text())
    manager = layout["Visualization Manager"]
    shown = {d["Topic"]["Value"] for d in manager["Displays"] if "Topic" in d}
    assert shown == TOPICS
    assert manager["Global Options"]["Fixed Frame"] == BASE_FRAME
    assert all(d["Class"].startswith("rviz_default_plugins/") for d in manager["Displays"])


def test_foxglove_shows_every_topic_in_panels_that_are_laid_out():
    layout = json.loads(parameter_path("foxglove/dotsim.json").read_text())
    panels = layout["configById"]

    def placed(part):
        if isinstance(part, str):
            return {part}
        return placed(part["first"]) | placed(part["second"])

    assert placed(layout["layout"]) == set(panels)
    text = json.dumps(panels)
    assert all(f'"{topic}"' in text for topic in TOPICS - {"/wrench"})
    forces = [path["value"] for path in panels["Plot!force"]["paths"]]
    assert forces == [f"/wrench.wrench.force.{axis}" for axis in "xyz"]
    assert panels["3D!skin"]["followTf"] == BASE_FRAME
