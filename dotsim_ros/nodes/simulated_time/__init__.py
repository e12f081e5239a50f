"""Simulated time: what nodes do when, and the steps that they take together."""
