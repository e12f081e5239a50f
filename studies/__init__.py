# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What proves the package and is not installed: the paper's tables and ours, rivals, the reference
by finite elements, hidden sets and speed. `run.run` runs one; `python -m studies` lists them."""
