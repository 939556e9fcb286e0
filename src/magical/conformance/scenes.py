"""Holds the distributions of sampled scenes against recorded ones (`scenes.json.gz`).

Two-sample Kolmogorov-Smirnov tests on every coordinate, chi-squared tests on colours, shapes and
counts; what the recordings hold constant must be equal. One exception: FixColour's mismatched
colour, which the recordings draw with a bias; only which block is mismatched is compared.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from magical.conformance.files import read_json
from magical.conformance.report import Line
from magical.errors import MagicalError, RecordingError
from magical.files import write_atomically
from magical.scene import Dynamics, Scene
from magical.tasks import Task, get_task
from magical.tasks.axes import DEMO

LIMIT = 1e-4  # smallest p after Bonferroni's correction over all tests
ROUNDING = 2e-5  # units and rad: recordings are rounded to five decimals
LEAST_RECORDED = 20  # scenes that have a block slot, for a test of that slot
SAMPLES = 1000  # scenes drawn of each environment, where the recording does not hold more
BIASED_COLOURS = "FixColour"

Row = Mapping[str, Any]
Value = TypeVar("Value", float, str)


@dataclass(frozen=True)
class Computed:
    """Sampled scenes of each environment, and how many of them the recording asks for."""

    scenes: Mapping[str, Sequence[Row]]
    wanted: Mapping[str, int]


@dataclass(frozen=True)
class _Test:
    task: str
    name: str
    p: float


def load(path: Path | str) -> dict[str, list[Row]]:
    """Read recorded scenes: environment -> [{robot, blocks, regions, dynamics}, ...].

    Lists may be empty, and a list of names will do, where there is nothing to compare with.
    Raises `RecordingError` for a damaged file.
    """
    data = read_json(path)
    if isinstance(data, list):
        data = {str(name): [] for name in data}
    if not isinstance(data, dict):
        raise RecordingError(
            f"{path}: expected environments with lists of scenes, found {type(data).__name__}"
        )
    try:
        for env, rows in data.items():
            _parse(env)
            data[env] = list(rows or ())
            for row in filter(None, data[env]):
                Scene.from_dict(row)
                Dynamics.from_dict(row["dynamics"])
    except (KeyError, TypeError, ValueError, MagicalError) as error:
        raise RecordingError(
            f"{path}: environment {env!r} is damaged; expected <Task>-<Variant>-v0 with a list of "
            f"{{robot, blocks, regions, dynamics}}, found: {error!r}"
        ) from error
    return data


def _parse(env: str) -> tuple[Task, str]:
    name, variant, version = env.split("-")
    task = get_task(name)
    task.axes_of(variant)
    if version != "v0":
        raise ValueError(f"version {version}")
    return task, variant


def compute(data: Mapping[str, Sequence[Row]], seed: int = 0, samples: int = SAMPLES) -> Computed:
    """Draw at least `samples` scenes of every environment, one of Demo, each from its own seed."""
    scenes = {}
    for i, (env, rows) in enumerate(data.items()):
        task, variant = _parse(env)
        rng = np.random.default_rng((seed, i))
        count = max(len(rows), 1 if variant == DEMO else samples)
        scenes[env] = [_row(*task.sample(variant, rng)) for _ in range(count)]
    return Computed(scenes, {env: len(rows) or len(scenes[env]) for env, rows in data.items()})


def _row(scene: Scene, dynamics: Dynamics) -> Row:
    row = scene.to_dict()
    return {key: row[key] for key in ("robot", "blocks", "regions")} | {
        "dynamics": list(astuple(dynamics))
    }


def write(computed: Computed, out: Path | str) -> None:
    """Write as many scenes of each environment as the recording holds, in its format."""
    scenes = {env: rows[: computed.wanted[env]] for env, rows in computed.scenes.items()}
    with write_atomically(out) as file:
        file.write(json.dumps(scenes).encode())


def compare(data: Mapping[str, Sequence[Row]], computed: Computed) -> list[Line]:
    """One line a task: the smallest p of all its tests; none where no scenes were recorded."""
    tests = [
        test
        for env, rows in data.items()
        if (recorded := [row for row in rows if row])
        for test in _tests(env, recorded, computed.scenes[env])
    ]
    return [_line(task, tests) for task in dict.fromkeys(test.task for test in tests)]


def _line(task: str, tests: Sequence[_Test]) -> Line:
    own = [test for test in tests if test.task == task]
    worst = min(own, key=lambda test: test.p)
    figure = min(1.0, worst.p * len(tests))
    detail = f"{len(own)} tests, smallest p {worst.p:.2g}: {worst.name}"
    return Line(task, figure, LIMIT, "least p", figure >= LIMIT, detail)


def _tests(env: str, recorded: Sequence[Row], sampled: Sequence[Row]) -> Iterator[_Test]:
    task, variant = _parse(env)
    least = 1 if variant == DEMO else LEAST_RECORDED
    found = {
        **_p_values(_coordinates(recorded), _coordinates(sampled), _ks, least),
        **_p_values(_words(recorded, task), _words(sampled, task), _chi_squared, least),
    }
    for name, p in found.items():
        yield _Test(task.name, f"{variant} {name}", p)


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
    """The p of two samples of a coordinate; 0 or 1 where the recorded one does not vary."""
    from scipy import stats

    a, b = np.array(recorded), np.array(sampled)
    if not a.size or np.ptp(a) <= ROUNDING:
        return float(a.size > 0 and np.abs(b - a[0]).max() <= ROUNDING)
    middle = np.median(a)
    # The test of the values alone hardly sees a range that is too wide on both sides.
    pairs = [(a, b), (abs(a - middle), abs(b - middle))]
    p_values = [float(stats.ks_2samp(*pair, method="asymp").pvalue) for pair in pairs]
    return min(1.0, len(pairs) * min(p_values))


def _chi_squared(recorded: Sequence[str], sampled: Sequence[str]) -> float:
    """The p of two samples of words; 0 or 1 where the recorded one does not vary."""
    from scipy import stats

    words = sorted({*recorded, *sampled})
    if len(set(recorded)) <= 1:
        return float(set(sampled) == set(recorded))
    table = [[Counter(sample)[word] for word in words] for sample in (recorded, sampled)]
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


def _words(rows: Sequence[Row], task: Task) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for row in rows:
        found.setdefault("number of blocks", []).append(str(len(row["blocks"])))
        found.setdefault("number of regions", []).append(str(len(row["regions"])))
        for i, (shape, colour, *_) in enumerate(row["blocks"]):
            if task.name == BIASED_COLOURS:
                colour = "its region's" if colour == row["regions"][i][0] else "another"
            found.setdefault(f"block {i} shape", []).append(shape)
            found.setdefault(f"block {i} colour", []).append(colour)
        for i, (colour, *_) in enumerate(row["regions"]):
            found.setdefault(f"region {i} colour", []).append(colour)
    return found
