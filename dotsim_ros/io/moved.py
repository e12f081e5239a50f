# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of folders and files of earlier releases, which lead to the new ones for a release."""

from __future__ import annotations

import importlib
import sys
import warnings
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MOVED = {
    "dotsim_ros.measured": "dotsim_ros.data",
    "dotsim_ros.metrics.images": "dotsim_ros.twin.image_metrics",
    "dotsim_ros.metrics.presses": "dotsim_ros.twin.press_metrics",
    "dotsim_ros.metrics.surfaces": "dotsim_ros.twin.surface_metrics",
    "dotsim_ros.metrics": "dotsim_ros.twin",
    "dotsim_ros.tasks.control.loop_recording": "dotsim_ros.control.loop.recording",
    "dotsim_ros.tasks.control.safety": "dotsim_ros.control.safety_layer.limits",
    "dotsim_ros.tasks.control": "dotsim_ros.control.safety_layer",
    "dotsim_ros.tasks": "dotsim_ros.control",
    "dotsim_ros.control.loop.bag": "dotsim_ros.control.loop.recording",
    "dotsim_ros.control.policy.card": "dotsim_ros.control.policy.network",
    "dotsim_ros.control.policy.demonstration_card": "dotsim_ros.control.policy.demonstration",
    "dotsim_ros.control.policy.expert": "dotsim_ros.control.policy.paths",
    "dotsim_ros.control.policy.export": "dotsim_ros.control.policy.resnet",
    **{
        f"dotsim_ros.{name}": f"dotsim_ros.io.{name}"
        for name in (
            "arrays",
            "cache",
            "cores",
            "documents",
            "files",
            "page",
            "printable",
            "progress",
            "provenance",
            "quantity",
            "replacement",
            "worker_pool",
        )
    },
}
"""The new name of each; the first that fits counts."""


class _Forward(Loader):
    def __init__(self, name: str) -> None:
        self._name = name
        self._spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # The import system has put the old name there.
        module.__spec__ = self._spec


class _Finder(MetaPathFinder):
    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        for old, new in MOVED.items():
            if name == old or name.startswith(f"{old}."):
                now = new + name.removeprefix(old)
                warnings.warn(f"{name} is {now}", DeprecationWarning, stacklevel=2)
                return ModuleSpec(name, _Forward(now), is_package=True)
        return None


def forward_moved() -> None:
    """Let the old names be imported."""
    sys.meta_path.insert(0, _Finder())
