# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a sensor is, as data: read from a YAML file, checked, frozen, and written here.

Each field is declared once, in `sections`, with its unit, range, default and meaning.
"""

from dotsim_ros.specification.files import (
    given_sensor,
    load_sensor,
    read_comment,
    read_source,
    sensor_from,
    sensor_path,
    write_sensor,
)
from dotsim_ros.specification.sections import (
    LARGEST_LENGTH_M,
    CameraSpecification,
    ContactSpecification,
    GelSpecification,
    LightingSpecification,
    MarkerSpecification,
    MaterialSpecification,
    NoiseSpecification,
    PatternSpecification,
    SolverSpecification,
    VignettingSpecification,
    face_drop_m,
)
from dotsim_ros.specification.sensor import (
    LARGEST_MEMORY_BYTES,
    SECTIONS,
    SensorSpecification,
    size_of,
)

__all__ = [
    "LARGEST_LENGTH_M",
    "LARGEST_MEMORY_BYTES",
    "SECTIONS",
    "CameraSpecification",
    "ContactSpecification",
    "GelSpecification",
    "LightingSpecification",
    "MarkerSpecification",
    "MaterialSpecification",
    "NoiseSpecification",
    "PatternSpecification",
    "SensorSpecification",
    "SolverSpecification",
    "VignettingSpecification",
    "face_drop_m",
    "given_sensor",
    "load_sensor",
    "read_comment",
    "read_source",
    "sensor_from",
    "sensor_path",
    "size_of",
    "write_sensor",
]
