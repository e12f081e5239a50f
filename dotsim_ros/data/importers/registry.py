# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The importers by the names of their sets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.importers.densetact import import_densetact
from dotsim_ros.data.importers.ecoflex_compression import import_ecoflex_compression
from dotsim_ros.data.importers.gelsight_mini_force import import_gelsight_mini_force

Importer = Callable[[Path, Path], DataSet]
"""Writes what a folder holds, as published, as a data set in a new folder."""

IMPORTERS: dict[str, Importer] = {
    "densetact": import_densetact,
    "ecoflex_compression": import_ecoflex_compression,
    "gelsight_mini_force": import_gelsight_mini_force,
}
