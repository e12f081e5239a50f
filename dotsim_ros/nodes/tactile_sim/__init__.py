"""tactile_sim: stands where the driver of an optical tactile sensor would."""
