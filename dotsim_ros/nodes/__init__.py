"""ROS 2 executables, one a file: they translate, schedule and report; no numerics."""
