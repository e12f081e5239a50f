# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sensor in worlds of rigid bodies, and tasks for learning in them.

Importing this registers the environments with Gymnasium.
"""

import gymnasium

_CLASSES = {
    "DenseTactPress-v0": "ball:PressEnvironment",
    "DenseTactFollow-v0": "ball:FollowEnvironment",
    "DenseTactBoxYaw-v0": "box_yaw:BoxYawEnvironment",
}
for _name, _class in _CLASSES.items():
    gymnasium.register(id=_name, entry_point=f"{__name__}.{_class}")
NAMES = tuple(_CLASSES)
