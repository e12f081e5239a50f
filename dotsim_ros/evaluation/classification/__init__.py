"""Which indenter touches the sensor: learnt from simulated images, judged on measured ones."""
