"""Pose graphs and their optimization."""
