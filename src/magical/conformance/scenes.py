"""Compares the distributions of sampled scenes with recorded ones (`scenes.json.gz`).

Two-sample Kolmogorov-Smirnov tests on every coordinate, chi-squared tests on colours, shapes and
counts; what is constant in the recordings must be equal. One exception: FixColour's mismatched
colour, which was sampled with a bias in the recordings; only which block is mismatched is compared.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from magical.conformance.recordings import Comparison, expecting, read_json, write_json
from magical.envs.ids import parse_env_id
from magical.scene import Dynamics, Scene
from magical.tasks import get_task
from magical.tasks.axes import DEMO

LIMIT = 1e-4  # of the smallest p-value, after Bonferroni correction over all tests
ROUNDING = 2e-5  # units and rad: recordings are rounded to five decimals
LEAST_RECORDED = 20  # the fewest values of a coordinate or category that are tested
SAMPLES = 1000  # scenes sampled for each environment, where the recording does not hold more
BIASED_COLOURS = "FixColour"

Row = Mapping[str, Any]
Value = TypeVar("Value", float, str)


@dataclass(frozen=True)
class SampledScenes:
    """Sampled scenes of each environment, and how many of them `write` writes."""

    scenes: Mapping[str, Sequence[Row]]
    wanted: Mapping[str, int]


@dataclass(frozen=True)
class _Test:
    task: str
    name: str
    p: float


def load(path: Path | str) -> dict[str, list[Row]]:
    """Read recorded scenes: environment -> [{robot, blocks, regions, dynamics}, ...].

    An environment's list may be empty, and a plain list of environments is accepted: their scenes
    are then sampled without being compared.

    Raises:
        RecordingError: The file cannot be read, or is not in the documented format.
    """
    data = read_json(path, dict, list)
    if isinstance(data, list):
        data = {str(name): [] for name in data}
    with expecting(path, "<Task>-<Variant>-v0 with {robot, blocks, regions, dynamics} each"):
        for env, rows in data.items():
            parse_env_id(env)
            data[env] = list(rows or ())
            for row in filter(None, data[env]):
                Scene.from_dict(row)
                Dynamics.from_dict(row["dynamics"])
    recorded: dict[str, list[Row]] = data
    return recorded


def compute(
    data: Mapping[str, Sequence[Row]], seed: int = 0, samples: int = SAMPLES
) -> SampledScenes:
    """Sample at least `samples` scenes of every environment (Demo: one).

    The random numbers of an environment depend on `seed` and its position in `data` alone.
    """
    scenes = {}
    for i, (env, rows) in enumerate(data.items()):
        env_id, rng = parse_env_id(env), np.random.default_rng((seed, i))
        task = get_task(env_id.task)
        count = max(len(rows), 1 if env_id.variant == DEMO else samples)
        scenes[env] = [row_of(*task.sample(env_id.variant, rng)) for _ in range(count)]
    return SampledScenes(scenes, {env: len(rows) or len(scenes[env]) for env, rows in data.items()})


def row_of(scene: Scene, dynamics: Dynamics) -> Row:
    """A scene in the recordings' format, with regions by their centres."""
    data = scene.to_dict()
    return {
        "robot": data["robot"],
        "blocks": data["blocks"],
        "regions": [[str(r.colour), *r.centre, r.height, r.width] for r in scene.regions],
        "dynamics": list(astuple(dynamics)),
    }


def write(computed: SampledScenes, out: Path | str) -> None:
    """Write as many scenes of each environment as were recorded, in the recordings' format."""
    write_json({env: rows[: computed.wanted[env]] for env, rows in computed.scenes.items()}, out)


def compare(data: Mapping[str, Sequence[Row]], computed: SampledScenes) -> list[Comparison]:
    """The smallest p-value of all tests, for each task with recorded scenes."""
    tests = [
        test
        for env, rows in data.items()
        if (recorded := [row for row in rows if row])
        for test in _tests(env, recorded, computed.scenes[env])
    ]
    return [_compare_task(task, tests) for task in dict.fromkeys(test.task for test in tests)]


def _compare_task(task: str, tests: Sequence[_Test]) -> Comparison:
    own = [test for test in tests if test.task == task]
    worst = min(own, key=lambda test: test.p)
    figure = min(1.0, worst.p * len(tests))
    detail = f"{len(own)} tests, smallest p {worst.p:.2g}: {worst.name}"
    return Comparison.at_least(task, figure, LIMIT, "least p", detail)


def _tests(env: str, recorded: Sequence[Row], sampled: Sequence[Row]) -> Iterator[_Test]:
    env_id = parse_env_id(env)
    task, variant = env_id.task, env_id.variant
    least = 1 if variant == DEMO else LEAST_RECORDED
    found = {
        **_p_values(_coordinates(recorded), _coordinates(sampled), _ks, least),
        **_p_values(_categories(task, recorded), _categories(task, sampled), _chi_squared, least),
    }
    for name, p in found.items():
        yield _Test(task, f"{variant} {name}", p)


def _p_values(
    recorded: Mapping[str, list[Value]],
    sampled: Mapping[str, list[Value]],
    test: Callable[[Sequence[Value], Sequence[Value]], float],
    least: int,
) -> dict[str, float]:
    pairs = {
        name: (recorded.get(name, []), sampled.get(name, [])) for name in {**recorded, **sampled}
    }
    return {name: test(a, b) for name, (a, b) in pairs.items() if min(len(a), len(b)) >= least}


def _ks(recorded: Sequence[float], sampled: Sequence[float]) -> float:
    """The p-value for two samples of a coordinate; 0 or 1 where it is constant in `recorded`."""
    from scipy import stats

    a, b = np.array(recorded), np.array(sampled)
    if not a.size or np.ptp(a) <= ROUNDING:
        return float(a.size > 0 and np.abs(b - a[0]).max() <= ROUNDING)
    middle = np.median(a)
    # On the values alone, the test has little power against a range too wide on both sides.
    pairs = [(a, b), (abs(a - middle), abs(b - middle))]
    p_values = [float(stats.ks_2samp(*pair, method="asymp").pvalue) for pair in pairs]
    return min(1.0, len(pairs) * min(p_values))


def _chi_squared(recorded: Sequence[str], sampled: Sequence[str]) -> float:
    """The p-value for two samples of a category; 0 or 1 where it is constant in `recorded`."""
    from scipy import stats

    values = sorted({*recorded, *sampled})
    if len(set(recorded)) <= 1:
        return float(set(sampled) == set(recorded))
    table = [[Counter(sample)[value] for value in values] for sample in (recorded, sampled)]
    return float(stats.chi2_contingency(table).pvalue)


def _coordinates(rows: Sequence[Row]) -> dict[str, list[float]]:
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
            found.setdefault("closest blocks", []).append(_closest(row["blocks"]))
    return found


def _closest(blocks: Sequence[Sequence[Any]]) -> float:
    return min(float(np.hypot(a[2] - b[2], a[3] - b[3])) for a, b in combinations(blocks, 2))


def _categories(task: str, rows: Sequence[Row]) -> dict[str, list[str]]:
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
