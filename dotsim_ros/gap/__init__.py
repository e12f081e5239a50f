"""The gap finder: where simulation and measurement disagree, which effect is missing, and the
model with it. Imports no ROS."""
