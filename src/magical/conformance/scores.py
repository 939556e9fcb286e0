"""Holds both scoring rules against recorded final states (`scores.json.gz`)."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from magical.conformance.files import read_json
from magical.conformance.report import Line
from magical.errors import MagicalError, RecordingError
from magical.files import write_atomically
from magical.scene import Poses, Scene
from magical.tasks import get_task

LIMIT = 1e-9
RULES = ("score", "published_code_score")

Entry = Mapping[str, Any]


def load(path: Path | str) -> list[Entry]:
    """Read final states: [{task, variant, scene, final, and perhaps the two scores}, ...].

    Raises `RecordingError` for a damaged file.
    """
    data = read_json(path)
    if not isinstance(data, list):
        raise RecordingError(f"{path}: expected a list of states, found {type(data).__name__}")
    for i, entry in enumerate(data):
        try:
            _check(entry)
        except (KeyError, TypeError, ValueError, MagicalError) as error:
            raise RecordingError(
                f"{path}: state {i} is damaged; expected task, scene and final {{robot, blocks}}, "
                f"and the scores, if any, as numbers; found: {error!r}"
            ) from error
    return data


def _check(entry: Entry) -> None:
    task = get_task(entry["task"])
    scene, final = Scene.from_dict(entry["scene"]), Scene.from_dict(entry["final"])
    task.validate(scene)
    if len(scene.blocks) != len(final.blocks):
        raise ValueError(f"{len(scene.blocks)} blocks in scene, {len(final.blocks)} in final")
    if not all(math.isfinite(entry[rule]) for rule in RULES if rule in entry):
        raise ValueError("a score that is not finite")


def compute(data: Sequence[Entry]) -> list[dict[str, float]]:
    """Each state's `score` and `published_code_score`, in the data's order."""
    return [_scores(entry) for entry in data]


def _scores(entry: Entry) -> dict[str, float]:
    task, scene = get_task(entry["task"]), Scene.from_dict(entry["scene"])
    poses = Poses.at_rest(Scene.from_dict(entry["final"]))
    return {
        "score": task.score(scene, poses),
        "published_code_score": task.published_code_score(scene, poses),
    }


def compare(data: Sequence[Entry], computed: Sequence[Mapping[str, float]]) -> list[Line]:
    """One line a task: the largest difference in either score; none without recorded scores."""
    differences: dict[str, list[float]] = {}
    for entry, scores in zip(data, computed, strict=True):
        found = [abs(entry[rule] - scores[rule]) for rule in RULES if rule in entry]
        if found:
            differences.setdefault(entry["task"], []).append(max(found))
    return [
        Line(task, max(values), LIMIT, "score", max(values) <= LIMIT, f"{len(values)} states")
        for task, values in differences.items()
    ]


def write(computed: Sequence[Mapping[str, float]], out: Path | str) -> None:
    """Write what was computed as a JSON list."""
    with write_atomically(out) as file:
        file.write(json.dumps(computed).encode())
