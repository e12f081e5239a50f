"""The nodes of the closed loop in one process."""
