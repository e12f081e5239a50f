"""Commands that need no ROS graph: one verb a file, imported when it is used."""
