"""Closed loops of several nodes, for programs that start and judge them."""
