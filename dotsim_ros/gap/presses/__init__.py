"""The gap finder on skin and force: evidence, inference, and the answer."""
