"""indenter_player: plays presses as poses of the indenter."""
