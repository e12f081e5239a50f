"""Shapes: poses, the sensor's body and camera, and the rigid indenters that press it."""
