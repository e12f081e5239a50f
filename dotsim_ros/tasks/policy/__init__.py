"""The policy that follows paths by touch: its training, its inputs, and what guards the arm."""
