"""Plots, learning curves, scenes and rollouts as images."""
