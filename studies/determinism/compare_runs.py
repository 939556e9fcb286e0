r"""Differences between runs of the physics over time: tables, and a figure for its page.

    python studies/determinism/pymunk_versions.py runs --at-roots --out before.npz
    python studies/determinism/pymunk_versions.py runs --out after.npz
    python -m studies.determinism.compare_runs --published published.npz --nudged nudged.npz \
        --before before.npz --after after.npz --figure studies/determinism/determinism.png

published.npz and nudged.npz are of pymunk 5.6.0: see `pymunk_versions.py`. Motions are compared
with the recordings of the published environments, nudged ones with published.npz; random actions
are compared with published.npz.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from magical.scene.poses import FIRST_BLOCK, ROBOT
from tests.reference import motions
from tests.reference.recordings import DATA

KINDS = ("drive", "turn", "push", "grip")
MOTION_STEPS = (1, 3, 5, 10, 20)
WALK_STEPS = (1, 5, 10, 20, 40)
ROUNDING = 5e-8  # of the recordings
COLOURS = {"before": "#c8467c", "after": "#2f7fb5", "nudged": "0.55"}
LABELS = {
    "before": "fingers at their roots",
    "after": "fingers displaced",
    "nudged": "pymunk 5.6.0, finger moved by one spacing",
}

Runs = dict[str, NDArray[np.float64]]  # poses (runs, steps, bodies, 3)


def read(path: Path) -> Runs:
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def growth(found: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest difference of robot and blocks up to each step, (runs, steps)."""
    rows = [ROBOT, *range(FIRST_BLOCK, found.shape[2])]
    difference = np.abs(found - reference)[:, :, rows].max(axis=(2, 3))
    return np.maximum.accumulate(difference, axis=1)


def recorded() -> Runs:
    """The recorded motions in the same arrays; fingers and eyes are left 0."""
    arrays = {}
    for name, motion in motions.load(DATA / "motions.json").items():
        robot = np.array(motion["robot_pose"])[1:]
        blocks = np.array(motion["block_poses"])[1:].reshape(len(robot), -1, 3)
        poses = np.zeros((1, len(robot), FIRST_BLOCK + blocks.shape[1], 3))
        poses[0, :, ROBOT], poses[0, :, FIRST_BLOCK:] = robot, blocks
        arrays[f"motion/{name}"] = poses
    return arrays


def motions_of(runs: Runs, kind: str) -> list[str]:
    prefix = "motion/"
    names = (name for name in runs if name.startswith(prefix))
    return [name for name in names if motions._kind(name.removeprefix(prefix)) == kind]


def worst_motion(runs: Runs, reference: Runs, kind: str) -> NDArray[np.float64]:
    """The largest difference of any motion of a kind at each step; ended motions stay as they are.

    Of several runs of a motion, the median counts.
    """
    curves = [
        np.median(growth(runs[name], reference[name]), axis=0) for name in motions_of(runs, kind)
    ]
    length = max(map(len, curves))
    padded = [np.append(curve, [curve[-1]] * (length - len(curve))) for curve in curves]
    return np.array(np.max(padded, axis=0))


def print_motions(curves: dict[str, dict[str, NDArray[np.float64]]]) -> None:
    print("| Motion | | " + " | ".join(f"after {step}" for step in MOTION_STEPS) + " |")
    print("| --- | --- |" + " --- |" * len(MOTION_STEPS))
    for kind in KINDS:
        for which, by_kind in curves.items():
            curve = by_kind[kind]
            cells = [f"{curve[n - 1]:.0e}" if n <= len(curve) else "" for n in MOTION_STEPS]
            print(f"| {kind} | {LABELS[which]} | " + " | ".join(cells) + " |")


def print_walks(runs: dict[str, Runs], reference: Runs) -> None:
    print("| Joint | Robot | | " + " | ".join(f"after {step}" for step in WALK_STEPS) + " |")
    print("| --- | --- | --- |" + " --- |" * len(WALK_STEPS))
    for name in (name for name in reference if name.startswith("walk/")):
        _, joint, company = name.split("/")
        for which, each in runs.items():
            curve = growth(each[name], reference[name])
            cells = [
                f"{np.median(curve[:, n - 1]):.0e} ({curve[:, n - 1].max():.0e})"
                for n in WALK_STEPS
            ]
            print(f"| {joint} | {company} | {LABELS[which]} | " + " | ".join(cells) + " |")


def print_limits(nudged: Runs, published: Runs) -> None:
    """How far nudged motions end up from the same without: what tests/reference's limits follow."""
    print("| Motion | Position | Robot's angle | Blocks' angles |")
    print("| --- | --- | --- | --- |")
    for kind in KINDS:
        largest = np.zeros(3)
        for name in motions_of(nudged, kind):
            difference = nudged[name] - published[name]  # (runs, steps, bodies, 3)
            distance = np.hypot(difference[..., 0], difference[..., 1])
            angle = np.abs(difference[..., 2])
            found = (
                distance[..., [ROBOT, *range(FIRST_BLOCK, distance.shape[-1])]].max(),
                angle[..., ROBOT].max(),
                angle[..., FIRST_BLOCK:].max(initial=0.0),
            )
            largest = np.maximum(largest, found)
        print(f"| {kind} | " + " | ".join(f"{each:.1e}" for each in largest) + " |")


def draw(curves: dict[str, dict[str, NDArray[np.float64]]], path: Path) -> None:
    figure = Figure(figsize=(9.0, 2.8), layout="constrained")
    panels: Any = figure.subplots(1, len(KINDS), sharey=True)
    for axes, kind in zip(panels, KINDS, strict=True):
        for which, by_kind in curves.items():
            curve = np.maximum(by_kind[kind], 1e-12)
            steps = np.arange(1, len(curve) + 1)
            axes.plot(steps, curve, color=COLOURS[which], linewidth=1.4, label=LABELS[which])
        axes.axhline(ROUNDING, color="0.6", linewidth=0.8, linestyle=":")
        axes.set(title=kind, xlabel="control steps", yscale="log", ylim=(1e-12, 1))
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set(ylabel="largest difference")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside lower center", ncols=len(labels))
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n\n")[0],
        epilog="All files are written by studies/determinism/pymunk_versions.py runs.",
    )
    helps = {
        "published": "pymunk 5.6.0",
        "nudged": "the same with --nudges",
        "before": "the installed pymunk with --at-roots",
        "after": "the installed pymunk",
    }
    for name, text in helps.items():
        parser.add_argument(f"--{name}", type=Path, required=True, help=f".npz of {text}")
    parser.add_argument("--figure", type=Path, help="write the figure of the motions here")
    arguments = parser.parse_args()
    runs = {name: read(getattr(arguments, name)) for name in ("before", "after", "nudged")}
    published, recordings = read(arguments.published), recorded()
    curves = {
        which: {
            kind: worst_motion(each, published if which == "nudged" else recordings, kind)
            for kind in KINDS
        }
        for which, each in runs.items()
    }
    print_motions(curves)
    print()
    print_walks(runs, published)
    print()
    print_limits(runs["nudged"], published)
    if arguments.figure:
        draw(curves, arguments.figure)


if __name__ == "__main__":
    main()
