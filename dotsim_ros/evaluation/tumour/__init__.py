"""Whether a soft skin hides a bulge or a dent: learnt in simulation, judged on another solver's."""
