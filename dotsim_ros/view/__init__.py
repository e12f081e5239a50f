"""Bags made visible: a video and a contact sheet of image, depth, skin and force."""
