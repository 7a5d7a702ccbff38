"""Scan matching and its covariance."""
