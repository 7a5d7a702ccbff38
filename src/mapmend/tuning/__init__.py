"""Automatic choice of a robust kernel's parameter: Mazuran et al. (MC), section V."""
