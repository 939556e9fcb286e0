"""Compares the physics with recorded motions (`motions.json`)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.grouping import group_by
from magical.physics import Simulation
from magical.scene import NUM_ACTIONS, POINTS, Block, Colour, Pose, Scene
from tests.reference.recordings import Comparison, expecting, read_json, write_json

FIRST_STEPS = 3
# Poses in the first steps (units or rad): twice the recordings' rounding.
FIRST_LIMIT = 1e-7
# At any step: slightly more than the published physics deviates from itself when one finger is
# moved by one floating-point spacing during the first two steps (docs/determinism.md).
POSITION_LIMIT = 0.003  # units: robot and blocks when driving, turning and pushing
ANGLE_LIMIT = 0.002  # rad: the robot
BLOCK_ANGLE_LIMIT = 0.005  # rad: the blocks
GRIP_LIMIT = 0.1  # units: robot and blocks when gripping
GRIP_ANGLE_LIMIT = 0.35  # rad: robot and blocks when gripping
_RESULTS = ("robot_pose", "finger_angles", "block_poses")

Motion = dict[str, Any]


def load(path: Path | str) -> dict[str, Motion]:
    """Read a motions file: name -> `robot`, `blocks`, `actions` and, if recorded, the results.

    Raises `RecordingError` for another file.
    """
    expected = "JSON, name: {robot [[x, y], angle], blocks [[shape, [x, y], angle], ...], actions}"
    with expecting(path, expected):
        data: dict[str, Motion] = read_json(path, dict[str, Motion])
        for name, motion in data.items():
            _check(name, motion)
    return data


def _check(name: str, motion: Motion) -> None:
    _scene(motion)
    if not all(type(a) is int and a in range(NUM_ACTIONS) for a in motion["actions"]):
        raise ValueError(f"{name}: actions that are not integers from 0 to {NUM_ACTIONS - 1}")
    blocks = len(motion["blocks"])
    rows: tuple[tuple[int, ...], ...] = (3,), (2,), (blocks, 3) if blocks else (0,)
    for key, row in zip(_RESULTS, rows, strict=True):
        expected = (len(motion["actions"]) + 1, *row)
        if key in motion and np.array(motion[key], np.float64).shape != expected:
            raise ValueError(f"{name}: {key} not of shape {expected}")


write = write_json


def compute(data: Mapping[str, Motion]) -> dict[str, Motion]:
    """Simulate the motions: name -> `robot_pose`, `finger_angles`, `block_poses` at every step."""
    return {name: _simulate(_scene(motion), motion["actions"]) for name, motion in data.items()}


def compare(data: Mapping[str, Motion], computed: Mapping[str, Motion]) -> list[Comparison]:
    """The largest differences in the first steps and, for each quantity, at any step, by kind."""
    complete = [name for name, motion in data.items() if all(key in motion for key in _RESULTS)]
    comparisons = []
    for kind, names in group_by(complete, _kind).items():
        grip = kind == "grip"
        limits = {
            "first steps": (FIRST_LIMIT, "units or rad"),
            "position": (GRIP_LIMIT if grip else POSITION_LIMIT, "units"),
            "robot angle": (GRIP_ANGLE_LIMIT if grip else ANGLE_LIMIT, "rad"),
            "block angle": (GRIP_ANGLE_LIMIT if grip else BLOCK_ANGLE_LIMIT, "rad"),
        }
        figures = zip(*(_errors(data[name], computed[name]) for name in names), strict=True)
        for (quantity, (limit, unit)), errors in zip(limits.items(), figures, strict=True):
            if quantity != "block angle" or any(data[name]["blocks"] for name in names):
                worst = f"worst of {len(names)}: {names[int(np.argmax(errors))]}"
                found = Comparison(f"{kind} {quantity}", max(errors), limit, unit, worst)
                comparisons.append(found)
    return comparisons


def _errors(recorded: Motion, computed: Motion) -> tuple[float, float, float, float]:
    """The largest differences between two motions.

    Returns:
        The largest difference of any coordinate or angle of robot, fingers and blocks in the first
        steps; then, at any step, those of positions, of the robot's angle, and of block angles.
    """
    robot = np.array(computed["robot_pose"]) - np.array(recorded["robot_pose"])  # (T + 1, 3)
    fingers = np.array(computed["finger_angles"]) - np.array(recorded["finger_angles"])
    count = len(recorded["robot_pose"])
    blocks = np.array(computed["block_poses"]) - np.array(recorded["block_poses"])
    blocks = blocks.reshape(count, -1, 3)  # (T + 1, blocks, 3)
    first = np.hstack([robot, fingers, blocks.reshape(count, -1)])[: FIRST_STEPS + 1]
    position = float(np.hypot(robot[:, 0], robot[:, 1]).max())
    block_position = np.hypot(blocks[..., 0], blocks[..., 1])
    return (
        float(np.abs(first).max()),
        max(position, float(block_position.max(initial=0.0))),
        float(_angle_distance(robot[:, 2]).max()),
        float(_angle_distance(blocks[..., 2]).max(initial=0.0)),
    )


def _angle_distance(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Absolute differences of angles modulo full turns, in [0, pi]."""
    return np.abs((difference + math.pi) % (2 * math.pi) - math.pi)


def _kind(name: str) -> str:
    for kind, words in {"grip": ("grip",), "push": ("push",), "turn": ("turn", "arc")}.items():
        if name.startswith(words):
            return kind
    return "drive"


def _scene(motion: Motion) -> Scene:
    (x, y), angle = motion["robot"]
    angle = _unrounded(angle)
    blocks = tuple(
        Block(shape, Colour.RED, Pose(bx, by, turn)) for shape, (bx, by), turn in motion["blocks"]
    )
    return Scene(Pose(x, y, angle), blocks)


def _unrounded(angle: float) -> float:
    """The multiple of a quarter turn whose recording (seven decimals) is `angle`, or `angle`.

    The digits lost to rounding matter: they decide the direction of the fingers' pin joints
    (`physics.simulation.finger_position`).
    """
    turns = round(angle / (math.pi / 2)) * (math.pi / 2)
    return turns if round(turns, 7) == angle else angle


def _simulate(scene: Scene, actions: Sequence[int]) -> Motion:
    simulation = Simulation(scene)
    history = [simulation.poses()]
    for action in actions:
        simulation.step(POINTS[action])
        history.append(simulation.poses())
    return {
        "robot_pose": [list(poses.robot) for poses in history],
        "finger_angles": [poses.finger_angles.tolist() for poses in history],
        "block_poses": [poses.blocks.tolist() for poses in history],
    }
