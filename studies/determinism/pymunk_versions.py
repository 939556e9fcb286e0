"""Runs the physics with whatever version of pymunk is installed, and writes what comes out.

The package itself runs with pymunk 7.3. The published environments ran with 5.6.0, which this
script is for; in an environment of its own:

    cd studies/determinism
    python -m venv old && old/bin/pip install pymunk==5.6.0 numpy
    old/bin/python pymunk_versions.py first-steps --at-roots --out first-steps.json
    old/bin/python pymunk_versions.py runs --at-roots --out published.npz
    old/bin/python pymunk_versions.py runs --at-roots --nudges 100 --out nudged.npz
    old/bin/python pymunk_versions.py replays human --at-roots

The first is the file beside the tests of the physics. `compare_runs.py` compares the next two with
runs of the installed package. In the last, `human` is a folder of imported human demonstrations.
"""

import argparse
import collections
import collections.abc
import json
import math
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymunk
from numpy.typing import NDArray

ROOT = Path(__file__).parents[2]
DECIMALS = 12  # of the poses in the file of first steps
NUM_ACTIONS = 18
WALKS = 60  # runs of random actions
WALK_STEPS = 40
START_SHIFT = 1e-9  # units, of the robot's start in shifted replays

Poses = NDArray[np.float64]  # (steps, bodies, 3): x, y, angle


def prepare(*, at_roots: bool) -> None:
    """Make `magical.physics` importable without pymunk 7.3 and compiled code."""
    collections.Sequence = collections.abc.Sequence  # type: ignore[attr-defined]  # pymunk 5.6
    package = types.ModuleType("magical")
    package.__path__ = [str(ROOT / "src" / "magical")]
    sys.modules["magical"] = package
    sys.path.append(str(ROOT))  # for tests.reference
    plain = types.ModuleType("magical.physics.chipmunk")
    setattr(plain, "c_functions", lambda: None)  # noqa: B010
    setattr(plain, "address", None)  # noqa: B010
    sys.modules[plain.__name__] = plain
    if at_roots:
        from magical.physics import robot
        from magical.scene.geometry import to_workspace

        setattr(robot, "finger_position", lambda _, root, pose: to_workspace(root, pose))  # noqa: B010


def first_steps() -> dict[str, list[list[float]]]:
    """For each task, after one step of each action from its Demo scene: x, y, three angles."""
    from magical.physics import Simulation
    from magical.tasks import TASKS

    def step(scene: Any, action: int) -> list[float]:
        simulation = Simulation(scene)
        simulation.step(action)
        poses = simulation.poses()
        return [round(value, DECIMALS) for value in (*poses.robot, *poses.finger_angles.tolist())]

    return {
        name: [step(task.demo, action) for action in range(NUM_ACTIONS)]
        for name, task in TASKS.items()
    }


def motions(nudges: int) -> dict[str, NDArray[np.float64]]:
    """The recorded motions: name -> poses (1, steps, bodies, 3), or one run for each nudge."""
    from tests.reference import motions as recorded
    from tests.reference.recordings import DATA

    rng = np.random.default_rng(0)
    data = recorded.load(DATA / "motions.json")
    return {
        f"motion/{name}": np.stack(
            [
                run(recorded._scene(motion), motion["actions"], nudge)
                for nudge in nudges_of(rng, nudges)
            ]
        )
        for name, motion in data.items()
    }


def walks(nudges: int) -> dict[str, NDArray[np.float64]]:
    """Random actions, alone and beside a block, with two kinds of joints: (walks, steps, ...)."""
    results = {}
    for joint in ("pin", "pivot"):
        for company in ("alone", "block"):
            rng, nudge_rng = np.random.default_rng(1), np.random.default_rng(2)
            with_joint(joint)
            results[f"walk/{joint}/{company}"] = np.stack(
                [
                    run(*random_walk(rng, index, company), nudge)
                    for index in range(WALKS)
                    for nudge in nudges_of(nudge_rng, min(nudges, 1))
                ]
            )
    with_joint("pin")
    return results


def random_walk(rng: np.random.Generator, index: int, company: str) -> tuple[Any, list[int]]:
    """A scene of a robot, with or without a block within its reach, and actions."""
    from magical.scene.geometry import to_workspace
    from magical.scene.scene import Block, Pose, Scene
    from magical.scene.vocabulary import Colour, Shape

    x, y = rng.uniform(-0.45, 0.45, 2).tolist()
    robot = Pose(x, y, float(rng.uniform(-math.pi, math.pi)))
    offset = (float(rng.uniform(-0.1, 0.1)), float(rng.uniform(0.3, 0.45)))
    pose = Pose(*to_workspace(offset, robot), float(rng.uniform(-math.pi, math.pi)))
    blocks = (Block(list(Shape)[index % len(Shape)], Colour.RED, pose),)
    actions = np.repeat(rng.integers(0, NUM_ACTIONS, WALK_STEPS), rng.integers(1, 6, WALK_STEPS))
    actions[0] = actions[0] or 1  # a pin of zero length at rest has no direction
    return Scene(robot, blocks if company == "block" else ()), actions[:WALK_STEPS].tolist()


def with_joint(joint: str) -> None:
    """Hang the fingers on this kind of joint from now on."""
    from magical.physics import robot

    def pivot(body: Any, finger: Any, root: Any, origin: Any) -> Any:
        return pymunk.PivotJoint(body, finger, root, origin)

    names = types.SimpleNamespace(**vars(pymunk))
    if joint == "pivot":
        names.PinJoint = pivot
    setattr(robot, "pymunk", names)  # noqa: B010


Nudge = Callable[[Any], None]


def nudges_of(rng: np.random.Generator, count: int) -> Iterator[tuple[int, Nudge] | None]:
    """Pairs of a substep and what to do to the robot after it; a single None for no nudges."""
    if not count:
        yield None
    for _ in range(count):
        substep, side, axis = int(rng.integers(1, 21)), int(rng.integers(2)), int(rng.integers(2))
        towards = float(rng.choice([-9, 9]))

        def nudge(robot: Any, side: int = side, axis: int = axis, to: float = towards) -> None:
            position = list(robot.fingers[side].position)
            position[axis] = math.nextafter(position[axis], to)
            robot.fingers[side].position = tuple(position)

        yield substep, nudge


def run(scene: Any, actions: list[int], nudge: tuple[int, Nudge] | None) -> Poses:
    """Poses after each action; one finger is moved by one floating-point spacing for a nudge."""
    from magical.physics import Simulation

    simulation = Simulation(scene)
    simulation._compiled = None
    advance, substeps = simulation._space.step, 0

    def advance_and_nudge(seconds: float) -> None:
        nonlocal substeps
        advance(seconds)
        substeps += 1
        if nudge and substeps == nudge[0]:
            nudge[1](simulation._robot)

    setattr(simulation._space, "step", advance_and_nudge)  # noqa: B010
    history = []
    for action in actions:
        simulation.step(action)
        history.append(simulation.poses().bodies)
    return np.stack(history)


def replays(folder: Path, shift: float) -> dict[str, float]:
    """Mean score, by the published code's rule, of replayed demonstrations of each task."""
    from magical.physics import Simulation
    from magical.tasks import TASKS

    scores: dict[str, list[float]] = {}
    for file in sorted(folder.rglob("*.npz")):
        with np.load(file, allow_pickle=False) as arrays:
            header, actions = json.loads(arrays["header"].tobytes()), arrays["actions"].tolist()
        name = header["env_id"].removeprefix("magical/").partition("-")[0]
        task = TASKS[name]
        robot = task.demo.robot._replace(x=task.demo.robot.x + shift)
        simulation = Simulation(replace(task.demo, robot=robot))
        for action in actions:
            simulation.step(action)
        score = task.published_code_score(task.demo, simulation.poses())
        scores.setdefault(name, []).append(score)
    return {name: float(np.mean(each)) for name, each in scores.items()}


def write_first_steps(arguments: argparse.Namespace) -> None:
    lines = [f'  "{name}": {json.dumps(rows)}' for name, rows in first_steps().items()]
    arguments.out.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def write_runs(arguments: argparse.Namespace) -> None:
    arrays: dict[str, Any] = {**motions(arguments.nudges), **walks(arguments.nudges)}
    np.savez_compressed(arguments.out, **arrays)


def print_replays(arguments: argparse.Namespace) -> None:
    """A line for the start as recorded, and for the mean over shifted starts."""
    plain = replays(arguments.human, 0.0)
    print("task, start as recorded, mean and range over shifted starts")
    shifted = [replays(arguments.human, (1 + n) * START_SHIFT) for n in range(arguments.shifts)]
    for name, score in plain.items():
        others = [each[name] for each in shifted]
        more = f" {np.mean(others):.2f} {min(others):.2f} {max(others):.2f}" if others else ""
        print(f"{name} {score:.2f}{more}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    commands = parser.add_subparsers(required=True)
    parsers = {
        "first-steps": (write_first_steps, "one step of each action from each Demo scene, as JSON"),
        "runs": (write_runs, "the recorded motions and random actions, as an .npz of poses"),
        "replays": (print_replays, "scores of replayed human demonstrations"),
    }
    for name, (function, text) in parsers.items():
        command = commands.add_parser(name, help=text, description=text)
        command.set_defaults(function=function)
        command.add_argument(
            "--at-roots", action="store_true", help="fingers start at their roots, as published"
        )
        if name == "replays":
            command.add_argument("human", type=Path, help="folder of imported demonstrations")
            command.add_argument("--shifts", type=int, default=0, help="replays with moved starts")
        else:
            command.add_argument("--out", type=Path, required=True)
        if name == "runs":
            command.add_argument(
                "--nudges", type=int, default=0, help="nudged runs of each motion instead"
            )
    arguments = parser.parse_args()
    prepare(at_roots=arguments.at_roots)
    arguments.function(arguments)


if __name__ == "__main__":
    main()
