"""A sensor from photographs of a ball: no force gauge, no stage."""
