"""Whether a map is right, and where not: Mazuran et al., "A Statistical Measure for Map Consistency in SLAM" (MC)."""
