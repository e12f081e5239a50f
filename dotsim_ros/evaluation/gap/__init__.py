"""How well the gap finder names effects that were hidden on purpose."""
