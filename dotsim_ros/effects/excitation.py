# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a recording does to the gel: the conditions under which it excites an effect."""

from __future__ import annotations

import numpy as np

from dotsim_ros.data.recording import STILL_M, TOUCH_M, Phase, Recording

STRAINING_M = 1.0e-3
"""A shallower press strains the gel too little to distinguish one elastic law from another."""

REVERSAL_COSINE = -0.5
"""Two moves one after the other whose directions are this far apart go there and back."""

SOON_S = 0.15
"""A frame this soon after the motion has changed shows what only follows it."""

LATER_S = 10.0
"""A recording that ends sooner after the session's start does not show what changes with time."""


def touches(recording: Recording) -> bool:
    """Return whether the indenter presses at all."""
    return bool(np.any(recording.depth_m > TOUCH_M))


def strains(recording: Recording) -> bool:
    """Return whether the gel is pressed so deep that its law is more than linear."""
    return bool(np.any(recording.depth_m > STRAINING_M))


def unloads(recording: Recording) -> bool:
    """Return whether a frame shows the contact after it was deeper."""
    return any(
        phase is Phase.RELEASE and depth > TOUCH_M
        for phase, depth in zip(recording.phase, recording.depth_m, strict=True)
    )


def rests_after_contact(recording: Recording) -> bool:
    """Return whether a frame shows the skin untouched after it was pressed."""
    pressed = np.flatnonzero(recording.depth_m > TOUCH_M)
    return bool(pressed.size and np.any(recording.depth_m[pressed[0] :] < 0.0))


def reverses(recording: Recording) -> bool:
    """Return whether the indenter turns back in contact, holds between the two moves or not."""
    position = np.stack([pose.position_m for pose in recording.press.poses])
    last = None
    for frame in range(1, len(position)):
        move = position[frame] - position[frame - 1]
        length = float(np.linalg.norm(move))
        if recording.depth_m[frame] < TOUCH_M or length < STILL_M:
            continue
        if last is not None and float(move @ last) / length < REVERSAL_COSINE:
            return True
        last = move / length
    return False


def moves_in_contact(recording: Recording) -> bool:
    """Return whether the indenter presses and moves."""
    return touches(recording) and recording.has(Phase.LOAD, Phase.SLIDE, Phase.RELEASE)


def shows_transients(recording: Recording) -> bool:
    """Return whether a frame in contact comes soon after the motion has changed, by a speed that
    leads farther than the noise of a pose in that time."""
    stamp_s = recording.press.stamp_s
    position = np.stack([pose.position_m for pose in recording.press.poses])
    step_s = np.diff(stamp_s)
    if len(step_s) < 2 or not np.all(step_s > 0.0):
        return False
    velocity = np.diff(position, axis=0) / step_s[:, None]
    changed = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * SOON_S > STILL_M
    return bool(np.any(changed & (step_s[1:] <= SOON_S) & (recording.depth_m[2:] > TOUCH_M)))


def presses_late(recording: Recording) -> bool:
    """Return whether the indenter presses some time after the session's start."""
    end_s = recording.session_s + float(np.ptp(recording.press.stamp_s))
    return touches(recording) and end_s >= LATER_S
