"""The paper's explicit Material Point Method."""
