"""The library of effects: one module, one effect, in its attribute `EFFECT`."""
