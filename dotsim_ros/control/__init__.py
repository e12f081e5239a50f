# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is done with the sensor: the arm (`arm.simulated.SimulatedArm`), the policy that leads it
(`policy.training.train_policy`), the safety layer between both
(`safety_layer.supervisor.Supervisor`), environments for learning (`environments`), and the score of
a run (`loop.judge.judge`)."""
