"""Fit of the gel to measured presses, and which of its parameters the data identify."""
