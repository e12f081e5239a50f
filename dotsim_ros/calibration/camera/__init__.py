"""Fit of the camera and its lights to measured images."""
