"""Compares both scoring rules with recorded final states (`scores.json.gz`)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from magical.scene import Poses
from magical.tasks import get_task
from tests.reference.recordings import Comparison, expecting, read_json, scene_of, write_json

LIMIT = 1e-9  # difference of a score
RULES = ("score", "published_code_score")

ScoredState = Mapping[str, Any]


def load(path: Path | str) -> list[ScoredState]:
    """Read final states: [{task, variant, scene, final and, if recorded, scores}, ...].

    Raises `RecordingError` for another file.
    """
    with expecting(path, "JSON, a list of states with task, scene, final and perhaps scores"):
        data: list[ScoredState] = read_json(path, list[dict[str, Any]])
        for i, state in enumerate(data):
            _check(i, state)
    return data


write = write_json


def _check(index: int, state: ScoredState) -> None:
    task = get_task(state["task"])
    scene, final = scene_of(state["scene"]), scene_of(state["final"])
    task.validate(scene)
    if len(scene.blocks) != len(final.blocks):
        raise ValueError(
            f"state {index}: {len(scene.blocks)} blocks in scene, {len(final.blocks)} in final"
        )
    if not all(math.isfinite(state[rule]) for rule in RULES if rule in state):
        raise ValueError(f"state {index}: a score that is not finite")


def compute(data: Sequence[ScoredState]) -> list[dict[str, float]]:
    """The `score` and `published_code_score` of each state, in the order of `data`."""
    computed = []
    for state in data:
        task, scene = get_task(state["task"]), scene_of(state["scene"])
        poses = Poses.at_rest(scene_of(state["final"]))
        computed.append({rule: getattr(task, rule)(scene, poses) for rule in RULES})
    return computed


def compare(
    data: Sequence[ScoredState], computed: Sequence[Mapping[str, float]]
) -> list[Comparison]:
    """The largest difference in either score, for each task with recorded scores."""
    differences: dict[str, list[float]] = {}
    for state, scores in zip(data, computed, strict=True):
        found = [abs(state[rule] - scores[rule]) for rule in RULES if rule in state]
        if found:
            differences.setdefault(state["task"], []).append(max(found))
    return [
        Comparison(task, max(values), LIMIT, "score", f"{len(values)} states")
        for task, values in differences.items()
    ]
