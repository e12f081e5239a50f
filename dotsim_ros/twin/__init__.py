"""The twin: a sensor's gel and camera follow recorded poses; one simulation, one cache."""
