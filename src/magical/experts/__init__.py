"""Scripted demonstrators: closed-loop experts for every task, from any state."""

from magical.experts import clusters, lines, regions
from magical.experts.expert import Expert, Memory, expert_for
from magical.experts.goals import Goals, Move, Plan, Style, goals_of, register_goals
from magical.experts.rollout import Rollout, check_solvable, evaluate_expert, modules_of, rollout

__all__ = [
    "Expert",
    "Goals",
    "Memory",
    "Move",
    "Plan",
    "Rollout",
    "Style",
    "check_solvable",
    "clusters",
    "evaluate_expert",
    "expert_for",
    "goals_of",
    "lines",
    "modules_of",
    "regions",
    "register_goals",
    "rollout",
]
