"""What the nodes share: parameters, timing, faults, spinning."""
