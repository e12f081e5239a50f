# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`python -m studies`."""

import io
import sys

from studies.run import main

if __name__ == "__main__":
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Studies report their progress, which a file or a pipe shows while they run.
        sys.stdout.reconfigure(line_buffering=True)
    sys.exit(main(sys.argv[1:]))
