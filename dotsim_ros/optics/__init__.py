# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the camera sees: depth, normals, material points, and the image. Entry:
`renderer.SkinRenderer`, `image.ImageRenderer`."""
