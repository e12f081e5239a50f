"""What is done with the sensor: the arm that moves it, and controllers that are tested on both."""
