"""Derivatives of skin and wrench by everything that the implicit gel depends on."""
