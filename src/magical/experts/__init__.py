"""Scripted experts."""

from magical.experts.expert import Expert, expert_for
from magical.experts.goals import get_goals, register_goals
from magical.experts.memory import Memory
from magical.experts.planning import Goals, Move, Plan, Strategy
from magical.experts.rollout import Rollout, check_solvable, evaluate_expert, rollout
from magical.experts.state_view import StateView

__all__ = [
    "Expert",
    "Goals",
    "Memory",
    "Move",
    "Plan",
    "Rollout",
    "StateView",
    "Strategy",
    "check_solvable",
    "evaluate_expert",
    "expert_for",
    "get_goals",
    "register_goals",
    "rollout",
]
