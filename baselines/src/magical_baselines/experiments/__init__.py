"""Experiments: demonstrations, training and evaluation put together."""
