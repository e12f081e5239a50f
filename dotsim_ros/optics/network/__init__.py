"""The network that completes the warped image: its card, its input, and how it is run."""
