"""tactile_policy: moves an arm along a path by touch."""
