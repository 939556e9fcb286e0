"""Scenes made to move with pymunk (Chipmunk), the only room that knows it."""

from magical.physics.world import World

__all__ = ["World"]
