"""tactile_record: writes what the sensor publishes to a bag."""
