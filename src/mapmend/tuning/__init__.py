"""The robust kernel that sets itself: Mazuran et al. (MC), section V."""
