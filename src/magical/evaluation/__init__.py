"""Policies, evaluation with fixed seeds, statistics, and the published scores. Needs no torch."""

from magical.evaluation.entry import (
    Entry,
    Record,
    RolloutScore,
    by_variant,
    read_entry,
    read_scores,
    summarise,
    write_scores,
)
from magical.evaluation.policy import (
    BUILT_IN,
    FunctionPolicy,
    NoopPolicy,
    Policy,
    RandomPolicy,
    load_policy,
    policy_names,
)
from magical.evaluation.protocol import Evaluation, environments
from magical.evaluation.published import (
    difference_from_published,
    published_methods,
    published_score,
    published_table,
    published_tasks,
)
from magical.evaluation.rollouts import evaluate

__all__ = [
    "BUILT_IN",
    "Entry",
    "Evaluation",
    "FunctionPolicy",
    "NoopPolicy",
    "Policy",
    "RandomPolicy",
    "Record",
    "RolloutScore",
    "by_variant",
    "difference_from_published",
    "environments",
    "evaluate",
    "load_policy",
    "policy_names",
    "published_methods",
    "published_score",
    "published_table",
    "published_tasks",
    "read_entry",
    "read_scores",
    "summarise",
    "write_scores",
]
