"""What two surfaces, images and forces differ by."""
