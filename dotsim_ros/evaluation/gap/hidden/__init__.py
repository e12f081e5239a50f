"""Realities with something wrong in them, to test the gap finder on.

Imports nothing of `dotsim_ros.gap`: a hidden effect follows a law of its own, not the library's.
"""
