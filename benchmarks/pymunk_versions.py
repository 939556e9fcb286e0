"""Steps the Demo scenes with whatever version of pymunk is installed, and writes the poses.

The package itself runs with pymunk 7.3. The published environments ran with 5.6.0, which this
script is for:

    python -m venv old && old/bin/pip install pymunk==5.6.0 numpy
    old/bin/python benchmarks/pymunk_versions.py --out tests/physics/first-steps.json
"""

import argparse
import collections
import collections.abc
import json
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SOURCES = Path(__file__).parents[1] / "src" / "magical"
DECIMALS = 12  # of the poses in the file
NUM_ACTIONS = 18


class PlainReader:
    """`magical.physics.chipmunk.BodyReader` through pymunk's properties."""

    def __init__(self, _: Any, bodies: list[Any]) -> None:
        self._bodies = bodies

    def read(self) -> NDArray[np.float64]:
        """x, y, angle and their velocities, (bodies, 6)."""
        return np.array(
            [[*b.position, b.angle, *b.velocity, b.angular_velocity] for b in self._bodies]
        )


def prepare() -> None:
    """Make `magical.physics` importable without the private functions of pymunk 7.3."""
    collections.Sequence = collections.abc.Sequence  # type: ignore[attr-defined]  # pymunk 5.6
    package = types.ModuleType("magical")
    package.__path__ = [str(SOURCES)]
    sys.modules["magical"] = package
    plain = types.ModuleType("magical.physics.chipmunk")
    functions = {
        "body_handle": lambda body: body,
        "motor_handle": lambda motor: motor,
        "get_angle": lambda body: body.angle,
        "set_angle": lambda body, angle: setattr(body, "angle", angle),
        "set_velocity": lambda body, velocity: setattr(body, "velocity", velocity),
        "set_motor_rate": lambda motor, rate: setattr(motor, "rate", rate),
        "BodyReader": PlainReader,
    }
    for name, function in functions.items():
        setattr(plain, name, function)
    sys.modules[plain.__name__] = plain


def first_steps() -> dict[str, list[list[float]]]:
    """For each task, after one step of each action from its Demo scene: x, y, three angles."""
    from magical.physics import robot
    from magical.physics.simulation import Simulation
    from magical.scene.geometry import to_workspace
    from magical.tasks import TASKS

    # As published: the fingers start at their roots (see magical/physics/pins.py).
    robot.finger_position = lambda _, root, pose: to_workspace(root, pose)

    def step(scene: Any, action: int) -> list[float]:
        simulation = Simulation(scene)
        simulation.step(action)
        poses = simulation.poses()
        return [round(value, DECIMALS) for value in (*poses.robot, *poses.finger_angles.tolist())]

    return {
        name: [step(task.demo, action) for action in range(NUM_ACTIONS)]
        for name, task in TASKS.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--out", type=Path, required=True, help="JSON file: poses after the first step"
    )
    arguments = parser.parse_args()
    prepare()
    rows = first_steps()
    lines = [f'  "{name}": {json.dumps(each)}' for name, each in rows.items()]
    arguments.out.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
