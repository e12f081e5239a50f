"""Effects: what a sensor may do that its model leaves out, the library of them, and overlays."""
