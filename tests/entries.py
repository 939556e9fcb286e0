"""Entries of given scores."""

from collections.abc import Mapping, Sequence
from typing import Any

from magical import __version__
from magical.envs import EnvId
from magical.evaluation import Entry, Record, RolloutScore
from magical.evaluation.protocol import Evaluated
from magical.tasks import parse_horizon


def entry_of(
    method: str,
    scores: Sequence[RolloutScore],
    *,
    record: Mapping[str, Any] | None = None,
    version: str = __version__,
    horizon: str = "appendix",
    **how: Any,
) -> Entry:
    """An entry; `how` are fields of `Evaluated`."""
    evaluated = Evaluated(
        env_ids=tuple(dict.fromkeys(row.env_id for row in scores)) or (EnvId("MakeLine", "Demo"),),
        rollouts=max(1, *(row.rollout + 1 for row in scores), 1),
        horizon=parse_horizon(horizon),
        **{"observation": "", "privileged": how.get("observation") == "state", **how},
    )
    made = {k: tuple(v) if isinstance(v, list) else v for k, v in (record or {}).items()}
    record = Record(**made)
    return Entry(method=method, evaluated=evaluated, record=record, scores=scores, version=version)
