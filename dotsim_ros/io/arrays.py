# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The types of arrays, by what an element is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
AnyFloatArray = NDArray[np.floating]
"""Floats of the precision that its owner computes with."""
IntArray = NDArray[np.int64]
"""Counts, numbers of frames, stamps in nanoseconds."""
IndexArray = NDArray[np.int32]
"""Vertices of triangles, nodes and cells of a grid: what kernels index by."""
BoolArray = NDArray[np.bool_]
ImageArray = NDArray[np.uint8]
"""(H, W, 3) or (F, H, W, 3): red, green, blue."""
