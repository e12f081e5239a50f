"""Fit of the gel to measured presses, and what the data can tell of each of its parameters."""
