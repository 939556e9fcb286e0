"""Export of demonstrations to a LeRobotDataset, written by LeRobot itself.

    python -m lerobot_env_magical.export DATASET FOLDER [--action-space continuous]

Features: both cameras at 96 x 96 (video), `action`, the one to imitate (an integer from 0 to 17; if
continuous, drive, turn and grip from -1 to 1), `next.done`, `next.reward` (the score, at the last
step), and, if all poses are known, `observation.state`. If any demonstration has labels,
`executed_action` has the executed actions. If a policy acted in some steps, `is_demonstrated` is
false in those to leave out. An episode's task is its instruction.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_env_magical.observation import STATE_SIZE, VIEWS, robot_states
from magical.demos import Dataset, Frames, Trajectory
from magical.errors import DatasetError
from magical.scene import PARTS
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE

CAMERAS = {view: f"observation.images.{view}" for view in VIEWS}
STATE = "observation.state"


def export_lerobot(dataset: Dataset, folder: Path | str, action_space: Any = None) -> int:
    """Write the dataset into a new folder; returns the number of frames, one for each action.

    `action_space` is "discrete" or "continuous" (default: continuous if any in the dataset are).

    Raises:
        TrajectoryError: discrete actions are requested, but some actions are not among the 18.
        DatasetError: the folder exists, or the dataset is empty.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    if Path(folder).exists() or not len(dataset):
        found = f"{folder}, which exists" if len(dataset) else "no demonstrations"
        raise DatasetError(f"export: expected demonstrations and a new folder, found {found}")
    space = action_space or dataset.action_space()
    written = LeRobotDataset.create(
        "local/magical",
        fps=int(CONTROL_RATE),
        features=features(dataset, space),
        root=folder,
        robot_type="magical",
        use_videos=True,
    )
    total = 0
    for trajectory in dataset:
        for frame in frames(trajectory.with_action_space(space), written.features):
            written.add_frame(frame)
            total += 1
        written.save_episode()
    written.finalize()
    return total


def features(dataset: Dataset, action_space: str) -> dict[str, Any]:
    """LeRobot's description of the columns."""
    size, camera = (FRAME_SIZE, FRAME_SIZE, 3), ["height", "width", "channels"]
    names = ["x", "y", "angle", "left_finger", "right_finger"]
    action: dict[str, Any] = {"dtype": "int64", "shape": (1,), "names": ["action"]}
    if action_space == "continuous":
        action = {"dtype": "float32", "shape": (len(PARTS),), "names": list(PARTS)}
    made: dict[str, Any] = {
        name: {"dtype": "video", "shape": size, "names": camera} for name in CAMERAS.values()
    }
    if all(entry.has_poses for entry in dataset.entries):
        made[STATE] = {"dtype": "float32", "shape": (STATE_SIZE,), "names": names}
    made |= {"action": action}
    made |= {"executed_action": action} if any(e.has_labels for e in dataset.entries) else {}
    flags = ["next.done"]
    flags += ["is_demonstrated"] if any(t.actors is not None for t in dataset) else []
    made |= {name: {"dtype": "bool", "shape": (1,), "names": None} for name in flags}
    return made | {"next.reward": {"dtype": "float32", "shape": (1,), "names": None}}


def frames(trajectory: Trajectory, wanted: Any) -> Any:
    """The columns in `wanted` of each step, as `add_frame` takes them."""
    steps = np.arange(len(trajectory))
    done, score = steps == steps[-1], trajectory.score
    columns: dict[str, Any] = {
        name: Frames(trajectory, view).take(steps) for view, name in CAMERAS.items()
    }
    if STATE in wanted:
        assert trajectory.bodies is not None
        columns[STATE] = robot_states(trajectory.bodies[:-1])
    columns |= {"action": trajectory.labels, "executed_action": trajectory.actions}
    columns |= {"next.done": done, "is_demonstrated": trajectory.is_demonstrated}
    final = trajectory.published_code_score if score is None else score
    columns["next.reward"] = np.where(done, final, 0.0)
    for step in steps:
        rows = {n: column[step] for n, column in columns.items() if n in wanted}
        shaped = {
            n: np.asarray(row, _dtype(wanted[n])).reshape(wanted[n]["shape"])
            for n, row in rows.items()
        }
        yield {**shaped, "task": trajectory.task.instruction(trajectory.scene)}


def _dtype(feature: dict[str, Any]) -> str:
    return "uint8" if feature["dtype"] == "video" else str(feature["dtype"])


def main() -> None:
    """Export a dataset on the command line."""
    parser = argparse.ArgumentParser(prog="python -m lerobot_env_magical.export")
    parser.add_argument("dataset", type=Path, help="a dataset of `magical demos`")
    parser.add_argument("folder", type=Path, help="the folder to create")
    parser.add_argument("--action-space", choices=("discrete", "continuous"))
    args = parser.parse_args()
    total = export_lerobot(Dataset.open(args.dataset), args.folder, args.action_space)
    print(f"wrote {args.folder}: {total} frames")


if __name__ == "__main__":
    main()
