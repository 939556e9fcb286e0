"""Simulation of scenes with pymunk (Chipmunk): the only room that imports it."""

from magical.physics.simulation import Simulation

__all__ = ["Simulation"]
