"""Real presses with a force: a few depths of a ball on a pad, and cylinders between plates."""
