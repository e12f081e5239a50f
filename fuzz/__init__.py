# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hostile input for every reader: mutated files, values out of range, full disks.

    make fuzz SECONDS=600
    python -m fuzz --seconds 60 --target bag
    python -m fuzz --target bag --case 1234    one case again, with its traceback

A case is a target and a number; the same number gives the same input. A reader may refuse an input
with one line that names the file, or take it where it is valid. All else is a finding: another
exception, a line that names nothing, no answer within `HANG_S`, more than `GROWTH_BYTES` of memory,
a value out of range that was taken, a good file that was lost.
"""
