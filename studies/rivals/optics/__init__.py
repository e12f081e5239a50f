# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models of the image to compare with: Tacto's, Taxim's, DiffTactile's and FOTS's, written again.

Each is fitted on the same frames as ours and predicts the images of a press. All of them add what
they predict to the idle image. Taxim, DiffTactile and FOTS get the depth and the normals of this
package's gel, which are nearer to the measured skin than those of their own simulators: the more
generous choice. Tacto shades what it clips, so it gets its own geometry.
"""
