# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`python -m studies`."""

import sys

from studies.run import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
