"""The arm: simulated, its kinematics, and the commands that it takes."""
