"""Measured data: trajectories in ROS 2 bags, real presses, and the motions that replay them."""
