"""Poses and their covariances in the plane."""
