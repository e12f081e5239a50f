# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Start a node's executable, wait until it is ready, stop it by SIGINT, expect exit status 0."""

import signal
import subprocess
import sys
import threading

READY_WITHIN_S = 120.0

process = subprocess.Popen(
    [sys.argv[1]], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
)
watchdog = threading.Timer(READY_WITHIN_S, process.kill)
watchdog.start()
assert process.stdout is not None
ready = False
for line in process.stdout:
    print(line, end="")
    if "ready:" in line and not ready:
        ready = True
        process.send_signal(signal.SIGINT)
watchdog.cancel()
status = process.wait()
print(f"ready: {ready}, exit status {status}")
sys.exit(0 if ready and status == 0 else 1)
