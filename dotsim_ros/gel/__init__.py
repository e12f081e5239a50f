"""The gel: a total-Lagrangian Material Point Method pressed by rigid indenters."""
