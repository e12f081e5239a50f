"""The sensor in worlds of rigid bodies, and tasks for learning in them.

Importing this registers the environments with Gymnasium.
"""

import gymnasium

gymnasium.register(
    id="DenseTactBoxYaw-v0",
    entry_point="dotsim_ros.tasks.environments.box_yaw:BoxYawEnvironment",
)
