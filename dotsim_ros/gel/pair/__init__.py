"""A gel in contact with a second deformable body, both solved together."""
