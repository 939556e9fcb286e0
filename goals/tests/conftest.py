"""Demonstrations for the tests of learners; those of the baselines."""

from baselines.tests.conftest import demos, expert_demos, trajectories

__all__ = ["demos", "expert_demos", "trajectories"]
