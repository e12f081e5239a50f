"""Models of the image compared on measured frames."""
