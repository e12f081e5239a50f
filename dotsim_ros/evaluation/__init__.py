"""The published comparisons, run by command."""
