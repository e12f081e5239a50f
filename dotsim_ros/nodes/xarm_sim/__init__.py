"""xarm_sim: stands where the driver of an xArm 7 would."""
