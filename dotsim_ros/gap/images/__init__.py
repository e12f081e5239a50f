"""The gap finder on images: effects of the camera and its lights."""
