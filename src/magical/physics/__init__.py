"""Simulation of scenes with pymunk (Chipmunk): the only subpackage that imports it."""

from magical.physics.simulation import Simulation

__all__ = ["Simulation"]
