"""The gel at equilibrium in every frame: grid, contact, solver, refinement."""
