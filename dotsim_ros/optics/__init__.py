"""What the camera sees: depth, normals, the skin's material points, and the image."""
