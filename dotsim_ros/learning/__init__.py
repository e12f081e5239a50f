# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Networks that learn a sensor's images from measured presses. Entry: `run.train_optics`."""
