"""xarm_adapter: between standard messages and the driver of a real xArm."""
