"""What the live page presses: a sensor of this process, or a running node."""
