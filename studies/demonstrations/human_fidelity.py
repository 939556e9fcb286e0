"""What the recovered human demonstrations say about the physics, and how well they are known.

    python studies/demonstrations/human_fidelity.py DATASET [--published SRC] [--figure errors.png]

DATASET comes from `magical demos import SRC --out DATASET`. Printed are three tables.

1. Recovery: of each task's frames, the share of pixels that the recovered poses render wrongly; the
   poses' uncertainty; how many final poses score what was recorded. With --published, also the mean
   absolute difference between the poses rendered at 96 x 96 and the recording's 4 x 4 averages.
2. Scores: every file whose score by the published code's rule is not the recorded one.
3. Predictions: from every recovered state the same actions are simulated for 1 and for 8 control
   steps, and compared with the poses recovered then. Windows in which a block moves count as
   pushing, or as gripping if the gripper is closed at their end; the others as driving. Velocities
   are estimated (`magical.demos.motion`). Beside each error stands the simulation's own
   sensitivity: how far two simulations come apart when the second starts from the state shifted at
   random by the recovery's uncertainty, and its last poses are shifted likewise. The third pair of
   columns is the same test with nothing wrong in the physics: recordings of this simulation itself,
   with the same actions, whose poses are shifted by the same uncertainty. There, too, velocities
   and the impulses in contacts are unknown at a window's start.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magical.demos import Dataset, Trajectory
from magical.demos.human.importing import find_published
from magical.demos.human.published import read_demonstration
from magical.demos.store.reader import estimated_states
from magical.physics import Simulation
from magical.progress import ProgressBar
from magical.render import Renderer
from magical.scene import ACTIONS
from magical.scene.actions import Gripper
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE
from magical.scene.poses import EYES, FINGERS, FIRST_BLOCK, ROBOT

HORIZONS = (1, 8)  # control steps
MOVED = 1e-3  # units: a block that moves by less in a window has not been pushed
PHASES = ("driving", "pushing", "gripping")

Array = NDArray[np.float64]


# What is compared, with the unit of tables and figures.
QUANTITIES = {
    "robot position": "1e-3 units",
    "robot angle": "1e-3 rad",
    "finger angle": "1e-3 rad",
    "block position": "1e-3 units",
    "block angle": "1e-3 rad",
}
SCALE = 1e3  # of these units


@dataclass(frozen=True, slots=True)
class Window:
    """One simulated window."""

    phase: str
    horizon: int
    errors: dict[str, float]  # against the recovered poses, by quantity
    sensitivity: dict[str, float]  # against the simulation from a shifted state


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path, help="a dataset of recovered demonstrations")
    parser.add_argument("--published", type=Path, metavar="SRC", help="the published files")
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw the prediction errors")
    parser.add_argument("--every", type=int, default=1, help="steps between windows (default: 1)")
    args = parser.parse_args()
    trajectories = [t for t in Dataset.open(args.dataset) if t.is_recovered]
    if not trajectories:
        print(f"{args.dataset}: no trajectories with recovered poses", file=sys.stderr)
        return 1
    print_recovery(trajectories, args.published)
    print_scores(trajectories)
    with ProgressBar("windows", len(trajectories)) as bar:
        windows: list[Window] = []
        own: list[Window] = []
        for trajectory in trajectories:
            windows += simulate_windows(trajectory, args.every)
            own += simulate_windows(own_recording(trajectory), args.every)
            bar.advance(1)
    print_predictions(windows, own)
    if args.figure:
        draw(windows, own, args.figure)
    return 0


def print_recovery(trajectories: list[Trajectory], published: Path | None) -> None:
    """One line for each task."""
    groups = defaultdict(list)
    for trajectory in trajectories:
        groups[trajectory.env_id.task].append(trajectory)
    files = {file.name: file for file in find_published(published)} if published else {}
    print_head(
        *("Task", "Files", "Wrong pixels, median", "Worst frame", "Robot", "Fingers", "Blocks"),
        *("Scores equal", "Difference at 96 x 96", "With the recording's dashes"),
    )
    for task, group in sorted(groups.items()):
        wrong = np.concatenate([t.metadata["recovery"]["wrong_pixels"] for t in group])
        equal = sum(t.published_code_score == t.metadata["recorded_score"] for t in group)
        spread = [
            f"{largest(group, name, 'position'):.1e}, {largest(group, name, 'angle'):.1e}"
            for name in ("robot", "fingers", "blocks")
        ]
        pairs = [differences_at_96(t, files) for t in group if files]
        differences = [f"{value:.4f}" for value in np.mean(pairs, axis=0)] if pairs else ["", ""]
        shares = f"{np.median(wrong):.4%}", f"{wrong.max():.4%}"
        print_row(task, len(group), *shares, *spread, f"{equal} of {len(group)}", *differences)


def largest(group: list[Trajectory], name: str, part: str) -> float:
    """The largest 95th percentile of a standard deviation in the files of a task."""
    return float(max(t.metadata["recovery"]["deviations"][name][part] for t in group))


def differences_at_96(trajectory: Trajectory, files: dict[str, Path]) -> tuple[float, float]:
    """Mean absolute difference of rendered poses from the averaged frames, of 255.

    First as everything is rendered here, then with the dashes as in the recording.
    """
    recorded = read_demonstration(files[trajectory.metadata["source"]]).averaged()
    assert trajectory.poses is not None
    found, rendered = [], np.empty((FRAME_SIZE, FRAME_SIZE, 3), np.uint8)
    for whole in (True, False):
        total = 0.0
        for view, frames in recorded.items():
            renderer = Renderer(trajectory.scene, view, whole_dashes=whole)
            for bodies, frame in zip(trajectory.poses, frames, strict=True):
                renderer.render(bodies, rendered)
                total += float(np.abs(rendered.astype(np.int16) - frame).mean())
        found.append(total / len(recorded) / len(trajectory.poses))
    return found[0], found[1]


def print_head(*cells: str) -> None:
    print_row(*cells)
    print_row(*("---" for _ in cells))


def print_row(*cells: object) -> None:
    print("|", " | ".join(map(str, cells)), "|")


def print_scores(trajectories: list[Trajectory]) -> None:
    """The files whose final poses score something else than recorded."""
    print()
    print_head("File", "Recorded", "Published code's rule", "Appendix's rule")
    for t in trajectories:
        if t.published_code_score != t.metadata["recorded_score"]:
            recorded = t.metadata["source"], t.metadata["recorded_score"]
            print_row(*recorded, t.published_code_score, t.score)


def simulate_windows(trajectory: Trajectory, every: int) -> Iterator[Window]:
    """The windows that start at every `every`-th time step."""
    assert trajectory.poses is not None
    states, rng = estimated_states(trajectory), np.random.default_rng(0)
    spread = uncertainty(trajectory)
    for start in range(0, len(trajectory) - max(HORIZONS) + 1, every):
        actions = trajectory.actions[start : start + max(HORIZONS)].tolist()
        shifted = states[start] + rng.normal(size=spread.shape) * spread
        path, other = (simulate(trajectory, s, actions) for s in (states[start], shifted))
        for horizon in HORIZONS:
            recorded = trajectory.poses[start : start + horizon + 1]
            end = other[horizon - 1] + rng.normal(size=recorded[0].shape) * spread[:, :3]
            moved = block_movement(recorded) > MOVED
            yield Window(
                phase(moved, actions[horizon - 1]),
                horizon,
                distances(path[horizon - 1], recorded[-1], moved),
                distances(path[horizon - 1], end, moved),
            )


def own_recording(trajectory: Trajectory) -> Trajectory:
    """The same actions in this simulation, with poses as uncertain as the recovered ones."""
    simulation, rng = Simulation(trajectory.scene, trajectory.dynamics), np.random.default_rng(1)
    spread, true = uncertainty(trajectory)[:, :3], simulation.read()[:, :3].copy()
    poses = [true]
    for action in trajectory.actions.tolist():
        simulation.step(action)
        before, true = true, simulation.read()[:, :3].copy()
        still = (true == before).all(axis=1, keepdims=True)
        shifted = true + rng.normal(size=true.shape) * spread
        poses.append(np.where(still, poses[-1], shifted))
    recovery = {"recovery": trajectory.metadata["recovery"]}
    scene, actions = trajectory.scene, trajectory.actions
    env_id = str(trajectory.env_id)
    return Trajectory.from_poses(env_id, scene, actions, np.stack(poses), metadata=recovery)


def uncertainty(trajectory: Trajectory) -> Array:
    """Standard deviations of a recovered state, (5 + blocks, 6)."""
    assert trajectory.poses is not None
    deviations = trajectory.metadata["recovery"]["deviations"]
    spread = np.zeros((trajectory.poses.shape[1], 6))
    rows = {"fingers": FINGERS, "eyes": EYES, "blocks": slice(FIRST_BLOCK, None)}
    for name, chosen in {"robot": slice(ROBOT, ROBOT + 1), **rows}.items():
        spread[chosen, :2] = deviations[name]["position"]
        spread[chosen, 2] = deviations[name]["angle"]
    spread[:, 3:] = np.sqrt(2.0) * CONTROL_RATE * spread[:, :3]  # of a difference of two poses
    return spread


def simulate(trajectory: Trajectory, state: Array, actions: list[int]) -> list[Array]:
    """The poses after each action."""
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    simulation.write(state)
    poses = []
    for action in actions:
        simulation.step(action)
        poses.append(simulation.read()[:, :3].copy())
    return poses


def block_movement(poses: Array) -> Array:
    """How far each block gets from where it is first, (blocks,)."""
    blocks = poses[:, FIRST_BLOCK:, :2]
    away: Array = np.linalg.norm(blocks - blocks[0], axis=2).max(axis=0)
    return away


def phase(moved: NDArray[np.bool_], action: int) -> str:
    if not moved.any():
        return "driving"
    return "gripping" if ACTIONS[action].gripper == Gripper.CLOSED else "pushing"


def distances(a: Array, b: Array, moved: NDArray[np.bool_]) -> dict[str, float]:
    """How far two sets of poses are apart; of fingers and moved blocks, the largest distance."""
    apart = a - b
    found = {
        "robot position": float(np.linalg.norm(apart[ROBOT, :2])),
        "robot angle": abs(float(apart[ROBOT, 2])),
        "finger angle": float(np.abs(apart[FINGERS, 2] - apart[ROBOT, 2]).max()),
    }
    if moved.any():
        blocks = apart[FIRST_BLOCK:][moved]
        found["block position"] = float(np.linalg.norm(blocks[:, :2], axis=1).max())
        found["block angle"] = float(np.abs(blocks[:, 2]).max())
    return found


def values(windows: list[Window], phase: str, horizon: int, name: str) -> tuple[Array, Array]:
    """Errors and sensitivities of one kind of window."""
    chosen = [w for w in windows if (w.phase, w.horizon) == (phase, horizon) and name in w.errors]
    errors = np.array([w.errors[name] for w in chosen])
    return errors, np.array([w.sensitivity[name] for w in chosen])


def print_predictions(windows: list[Window], own: list[Window]) -> None:
    """One line for each phase, horizon and quantity: medians and 95th percentiles."""
    print()
    print_head(
        *("Phase", "Steps", "Windows", "Quantity"),
        *("Error, median", "95 %", "Sensitivity, median", "95 %", "Own recordings, median", "95 %"),
    )
    for kind in PHASES:
        for horizon in HORIZONS:
            for name, unit in QUANTITIES.items():
                errors, sensitivity = values(windows, kind, horizon, name)
                control, _ = values(own, kind, horizon, name)
                if len(errors) and len(control):
                    kinds = (errors, sensitivity, control)
                    found = [np.percentile(v, q) * SCALE for v in kinds for q in (50, 95)]
                    cells = [f"{value:.2f}" for value in found]
                    print_row(kind, horizon, len(errors), f"{name}, {unit}", *cells)


def draw(windows: list[Window], own: list[Window], path: Path) -> None:
    """The share of windows (x) with errors up to y, for each quantity, phase and horizon."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, len(QUANTITIES), figsize=(16, 6), sharex=True)
    for row, horizon in enumerate(HORIZONS):
        for axis, (name, unit) in zip(axes[row], QUANTITIES.items(), strict=True):
            for colour, kind in zip(("C0", "C1", "C2"), PHASES, strict=True):
                errors, _ = values(windows, kind, horizon, name)
                control, _ = values(own, kind, horizon, name)
                if len(errors) and len(control):
                    shares = np.linspace(0, 100, 201)
                    for found, style in ((errors, "-"), (control, ":")):
                        quantiles = np.percentile(found, shares) * SCALE
                        axis.semilogy(shares, quantiles, style, color=colour, label=kind)
            steps = "1 step" if horizon == 1 else f"{horizon} steps"
            axis.set(title=f"{name}, {steps}", ylabel=unit)
            axis.grid(alpha=0.3)
    for axis in axes[1]:
        axis.set_xlabel("% of windows")
    lines, labels = axes[0, 0].get_legend_handles_labels()
    names = [f"{label}{'' if i % 2 == 0 else ', own recordings'}" for i, label in enumerate(labels)]
    figure.legend(lines, names, ncols=6, loc="lower center")
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    sys.exit(main())
