# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp, as all of the package imports it: `from dotsim_ros.warp_runtime import wp`.

What Warp compiles is kept in `$WARP_CACHE_PATH`, else with what else the package keeps. It would
end where the user's own cache cannot be written.
"""

from __future__ import annotations

import warp as wp

from dotsim_ros.files import cache_directory, usable_folder

# A program that has initialised Warp itself has chosen.
if wp.config.kernel_cache_dir is None:
    wp.config.kernel_cache_dir = str(usable_folder("WARP_CACHE_PATH", cache_directory() / "warp"))
