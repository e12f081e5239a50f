"""The paper's reinforcement learning: policies of several seeds, other worlds, blind moves."""
