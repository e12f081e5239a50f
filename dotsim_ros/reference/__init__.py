"""A finite-element reference of presses on the dome, solved by CalculiX in a process of its own."""
