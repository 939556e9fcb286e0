"""Compares the distributions of sampled scenes with recorded ones (`scenes.json.gz`).

Two-sample Kolmogorov-Smirnov tests on every coordinate, chi-squared tests on colours, shapes and
counts; what is constant in the recordings must be equal. One exception: FixColour's mismatched
colour was sampled with a bias in the recordings, so only which block is mismatched is compared.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from magical.envs.ids import parse_env_id
from magical.scene import Dynamics, Scene
from magical.tasks import get_task
from magical.tasks.axes import DEMO
from tests.reference.recordings import Comparison, expecting, read_json, scene_of, write_json

LIMIT = 1e-4  # for the smallest p-value, after Bonferroni correction over all tests
ROUNDING = 2e-5  # units and rad: recordings are rounded to five decimals
LEAST_RECORDED = 20  # a coordinate or category with fewer values is not tested
SAMPLES = 1000  # scenes sampled for each environment, unless the recording holds more
BIASED_COLOURS = "FixColour"

SceneRow = Mapping[str, Any]
Scenes = Mapping[str, Sequence[SceneRow]]  # of each environment
Value = TypeVar("Value", float, str)


def load(path: Path | str) -> dict[str, list[SceneRow]]:
    """Read recorded scenes: environment -> [{robot, blocks, regions, dynamics}, ...].

    An environment's list may be empty, and a plain list of environments is also accepted: scenes
    are then sampled but not compared. Raises `RecordingError` for another file.
    """
    with expecting(path, "JSON, <Task>-<Variant>-v0: {robot, blocks, regions, dynamics} each"):
        data = read_json(path, dict[str, list[dict[str, Any]] | None] | list[str])
        named = data if isinstance(data, dict) else dict.fromkeys(data)
        recorded: dict[str, list[SceneRow]] = {env: rows or [] for env, rows in named.items()}
        for env, rows in recorded.items():
            parse_env_id(env)
            for row in filter(None, rows):
                scene_of(row)
                Dynamics(*row["dynamics"])
                _coordinates([row])
                _categories(parse_env_id(env).task, [row])
    return recorded


def compute(data: Scenes, samples: int | None = None) -> Scenes:
    """Sample `SAMPLES` scenes of every environment (Demo: one), or as many as recorded, if more.

    An environment's random numbers depend only on its position in `data`.
    """
    scenes = {}
    for i, (env, rows) in enumerate(data.items()):
        env_id, rng = parse_env_id(env), np.random.default_rng((0, i))
        task = get_task(env_id.task)
        count = max(len(rows), 1 if env_id.variant == DEMO else samples or SAMPLES)
        scenes[env] = [row_of(*task.sample(env_id.variant, rng)) for _ in range(count)]
    return scenes


def row_of(scene: Scene, dynamics: Dynamics) -> SceneRow:
    """A scene in the recordings' format, with regions given by their centres."""
    data = scene.to_dict()
    return {
        "robot": data["robot"],
        "blocks": data["blocks"],
        "regions": [[str(r.colour), *r.centre, r.height, r.width] for r in scene.regions],
        "dynamics": list(astuple(dynamics)),
    }


write = write_json


def compare(data: Scenes, computed: Scenes) -> list[Comparison]:
    """The smallest p-value, Bonferroni-corrected over all tests, of each task with recordings."""
    tests: dict[str, dict[str, float]] = {}  # task: name of the test: p-value
    for env, rows in data.items():
        if recorded := [row for row in rows if row]:
            env_id = parse_env_id(env)
            found = _tests(env_id.task, env_id.variant, recorded, computed[env])
            tests.setdefault(env_id.task, {}).update(found)
    count, comparisons = sum(map(len, tests.values())), []
    for task, own in tests.items():
        worst, p = min(own.items(), key=lambda test: test[1])
        figure, detail = min(1.0, p * count), f"{len(own)} tests, smallest p {p:.2g}: {worst}"
        comparisons.append(Comparison(task, figure, LIMIT, "least p", detail, at_least=True))
    return comparisons


def _tests(
    task: str, variant: str, recorded: Sequence[SceneRow], sampled: Sequence[SceneRow]
) -> dict[str, float]:
    least = 1 if variant == DEMO else LEAST_RECORDED
    found = {
        **_p_values(_coordinates(recorded), _coordinates(sampled), _ks, least),
        **_p_values(_categories(task, recorded), _categories(task, sampled), _chi_squared, least),
    }
    return {f"{variant} {name}": p for name, p in found.items()}


def _p_values(
    recorded: Mapping[str, list[Value]],
    sampled: Mapping[str, list[Value]],
    test: Callable[[Sequence[Value], Sequence[Value]], float],
    least: int,
) -> dict[str, float]:
    return {
        name: test(values, sampled[name])
        for name, values in recorded.items()
        if min(len(values), len(sampled.get(name, ()))) >= least
    }


def _ks(recorded: Sequence[float], sampled: Sequence[float]) -> float:
    """The p-value for two samples of a coordinate; 0 or 1 if it is constant in `recorded`."""
    from scipy import stats

    a, b = np.array(recorded), np.array(sampled)
    if np.ptp(a) <= ROUNDING:
        return float(np.abs(b - a[0]).max() <= ROUNDING)
    middle = np.median(a)
    # The test on the values alone has little power against a range that is too wide on both sides.
    pairs = [(a, b), (abs(a - middle), abs(b - middle))]
    p_values = [float(stats.ks_2samp(*pair, method="asymp").pvalue) for pair in pairs]
    return min(1.0, len(pairs) * min(p_values))


def _chi_squared(recorded: Sequence[str], sampled: Sequence[str]) -> float:
    """The p-value for two samples of a category; 0 or 1 if it is constant in `recorded`."""
    from scipy import stats

    values = sorted({*recorded, *sampled})
    if len(set(recorded)) <= 1:
        return float(set(sampled) == set(recorded))
    table = [[Counter(sample)[value] for value in values] for sample in (recorded, sampled)]
    return float(stats.chi2_contingency(table).pvalue)


def _coordinates(rows: Sequence[SceneRow]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for row in rows:
        bodies = {"robot": row["robot"]}
        bodies |= {f"block {i}": block[2:] for i, block in enumerate(row["blocks"])}
        for body, pose in bodies.items():
            for axis, value in zip(("x", "y", "angle"), pose, strict=True):
                found.setdefault(f"{body} {axis}", []).append(value)
        for i, region in enumerate(row["regions"]):
            for axis, value in zip(("x", "y", "height", "width"), region[1:], strict=True):
                found.setdefault(f"region {i} {axis}", []).append(value)
        for i, value in enumerate(row["dynamics"]):
            found.setdefault(f"dynamics {i}", []).append(value)
        if len(row["blocks"]) > 1:
            pairs = combinations(row["blocks"], 2)
            closest = min(float(np.hypot(a[2] - b[2], a[3] - b[3])) for a, b in pairs)
            found.setdefault("closest blocks", []).append(closest)
    return found


def _categories(task: str, rows: Sequence[SceneRow]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for row in rows:
        found.setdefault("number of blocks", []).append(str(len(row["blocks"])))
        found.setdefault("number of regions", []).append(str(len(row["regions"])))
        for i, (shape, colour, *_) in enumerate(row["blocks"]):
            if task == BIASED_COLOURS:
                colour = "its region's" if colour == row["regions"][i][0] else "another"
            found.setdefault(f"block {i} shape", []).append(shape)
            found.setdefault(f"block {i} colour", []).append(colour)
        for i, (colour, *_) in enumerate(row["regions"]):
            found.setdefault(f"region {i} colour", []).append(colour)
    return found
