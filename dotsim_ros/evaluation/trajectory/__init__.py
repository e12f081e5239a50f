"""Paths followed by touch, judged by what was recorded."""
