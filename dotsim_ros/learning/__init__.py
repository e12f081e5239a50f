"""Networks that learn a sensor's images from measured presses."""
