"""time_stepper: moves simulated time on for nodes that the user launches."""
