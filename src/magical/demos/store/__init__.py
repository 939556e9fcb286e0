"""Datasets of trajectories on disk."""
