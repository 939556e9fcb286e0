"""Runs: starting, stopping and resuming them, their checkpoints, devices and random numbers."""
