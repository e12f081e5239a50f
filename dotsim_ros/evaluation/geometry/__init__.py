"""Models of the gel compared on measured presses: surfaces and forces."""
