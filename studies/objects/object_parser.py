"""How well objects are parsed from pixels, against the true poses.

python studies/objects/object_parser.py [--episodes 3] [--fit]

Scripted experts act in every environment; every fourth frame is parsed and compared. With --fit
the constants of the shape classifier and of the fingers are fitted on rendered initial scenes and
printed instead.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magical.demos.generate import demonstrate
from magical.demos.store.reader import TrajectorySource
from magical.envs.ids import all_env_ids
from magical.render import Renderer
from magical.scene import Poses, Scene, View
from magical.scene.constants import FINGER_OPEN
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Block
from magical.scene.vocabulary import COLOURS, SHAPES
from magical.tasks import get_task
from magical_goals.objects import parser as p
from magical_goals.objects.parser import Perception

SEED = 40_000
Floats = NDArray[np.float64]

NEAR = 0.08  # units: a parsed object is a true one's if it is nearer, and of the same colour
STRIDE = 4  # frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=3, help="of each environment")
    parser.add_argument("--fit", action="store_true")
    args = parser.parse_args()
    if args.fit:
        fit()
    else:
        measure(args.episodes)


def measure(episodes: int, perception: Perception = p.parse_frames) -> None:
    """Print a row of figures for each variant."""
    print("variant frames  ms  block  p95  robot  angle p95  finger  missed false shape regions")
    by_variant = defaultdict(list)
    for env_id in all_env_ids():
        for k in range(episodes):
            by_variant[env_id.variant].append(compare(env_id, SEED + k, perception))
    for variant, parts in by_variant.items():
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        show(variant, columns)


def compare(env_id: str, seed: int, perception: Perception) -> dict[str, NDArray[np.float64]]:
    """Errors of an expert's episode."""
    trajectory = demonstrate(env_id, seed=seed)
    source = TrajectorySource(trajectory)
    times = np.arange(0, len(trajectory), STRIDE)
    frames = np.empty((len(times), 96, 96, 3), np.uint8)
    view = source.frames(View.ALLO, 96, None)
    for frame, step in zip(frames, times.tolist(), strict=True):
        view.render(step, frame)
    start = time.process_time()
    parsed = perception(frames)
    spent = (time.process_time() - start) / len(times) * 1e3
    assert trajectory.poses is not None
    poses = trajectory.poses[times]
    turned = (parsed.robot[:, 2] - poses[:, 0, 2] + np.pi) % (2 * np.pi) - np.pi
    open_ = np.stack([poses[:, 1, 2] - poses[:, 0, 2], poses[:, 0, 2] - poses[:, 2, 2]], axis=1)
    errors = {
        "ms": np.full(len(times), spent),
        "robot": np.hypot(*(parsed.robot[:, :2] - poses[:, 0, :2]).T),
        "angle": np.abs(turned),
        "finger": np.abs(parsed.fingers - open_).ravel(),
    }
    scene = trajectory.scene
    found = [match(scene.blocks, poses[t, FIRST_BLOCK:], parsed, t) for t in range(len(times))]
    errors["block"] = np.concatenate([row[0] for row in found])
    errors["shape"] = np.concatenate([row[1] for row in found])
    errors["missed"] = np.array([row[2] for row in found], float)
    errors["false"] = np.array([row[3] for row in found], float)
    errors["regions"] = np.array(
        [regions_right(scene, parsed, t) for t in range(len(times))], float
    )
    return errors


def match(
    blocks: Sequence[Block], poses: Floats, parsed: p.ParsedFrames, t: int
) -> tuple[Floats, Floats, int, int]:
    """Distances and right shapes of the true blocks that were found; missed and false ones."""
    left = list(np.flatnonzero(parsed.colours[t] >= 0))
    distances, right = [], []
    for block, pose in zip(blocks, poses, strict=True):
        near = [
            (float(np.hypot(*(parsed.blocks[t, k] - pose[:2]))), k)
            for k in left
            if COLOURS[parsed.colours[t, k]] == block.colour
        ]
        if near and min(near)[0] < NEAR:
            distance, k = min(near)
            left.remove(k)
            distances.append(distance)
            right.append(float(SHAPES[parsed.shapes[t, k]] == block.shape))
    return np.array(distances), np.array(right), len(blocks) - len(distances), len(left)


def regions_right(scene: Scene, parsed: p.ParsedFrames, t: int) -> bool:
    """Whether all goal regions were found, every edge within 0.03 units, and no others."""
    found = parsed.region_colours[t] >= 0
    if found.sum() != len(scene.regions):
        return False
    for region in scene.regions:
        true = np.array([*region.centre, region.width / 2, region.height / 2])
        same = found & (parsed.region_colours[t] == COLOURS.index(region.colour))
        if not any(np.abs(parsed.regions[t, k] - true).max() < 0.03 for k in np.flatnonzero(same)):
            return False
    return True


def show(variant: str, c: dict[str, NDArray[np.float64]]) -> None:
    """Print one variant's figures."""
    block = c["block"] if len(c["block"]) else np.zeros(1)
    true = len(c["block"]) + c["missed"].sum()
    print(
        f"{variant:14} {len(c['ms']):6} {c['ms'].mean():.2f} {block.mean():.4f} "
        f"{np.quantile(block, 0.95):.4f} {c['robot'].mean():.4f} "
        f"{np.quantile(c['angle'], 0.95):.3f} "
        f"{c['finger'].mean():.3f} {c['missed'].sum() / max(true, 1):.5f} "
        f"{c['false'].sum() / max(true, 1):.5f} {c['shape'].mean():.4f} {c['regions'].mean():.4f}"
    )


def fit() -> None:
    """Print the constants of `magical_goals.objects.parser` that are fitted."""
    rng = np.random.default_rng(SEED)
    features, shapes, directions, angles = [], [], [], []
    slope, offset = p.FINGER_SLOPE, p.FINGER_OFFSET
    for task in ("ClusterColour", "FixColour", "FindDupe", "MatchRegions"):
        for _ in range(250):
            scene, _ = get_task(task).sample("TestAll", rng)
            bodies = np.zeros((5 + len(scene.blocks), 6))
            bodies[:, :3] = Poses.at_rest(scene).bodies
            open_ = rng.uniform(0.0, FINGER_OPEN, 2)
            bodies[1:3, 2] = bodies[0, 2] + open_ * (1, -1)
            frame = np.empty((1, 96, 96, 3), np.uint8)
            Renderer(scene, View.ALLO, 96).render(bodies, frame[0])
            directions += ((p.parse_frames(frame).fingers[0] - offset) / slope).tolist()
            angles += open_.tolist()
            found, which = block_features(frame, scene)
            features += found
            shapes += which
    print("FINGER_SLOPE, FINGER_OFFSET =", np.polyfit(directions, angles, 1).round(4).tolist())
    weights = classifier(np.array(features), np.array(shapes))
    print("SHAPE_WEIGHTS =", weights.round(2).tolist())
    print("accuracy", ((np.array(features) @ weights.T).argmax(1) == shapes).mean())


def block_features(frame: NDArray[np.uint8], scene: Scene) -> tuple[list[Floats], list[int]]:
    """The features of a frame's blocks, and their shapes' numbers."""
    rows = np.zeros((1, p.MAX_BLOCKS, p.FEATURES))
    parsed = p.parse_frames(frame, features=rows)
    features, shapes = [], []
    for block in scene.blocks:
        far = np.hypot(*(parsed.blocks[0] - block.pose[:2]).T)
        if COLOURS[parsed.colours[0, far.argmin()]] == block.colour and far.min() < 0.03:
            features.append(rows[0, far.argmin()])
            shapes.append(SHAPES.index(block.shape))
    return features, shapes


def classifier(features: NDArray[np.float64], shapes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Weights (4, 9) of multinomial logistic regression, by gradient descent."""
    mean, scale = features[:, :-1].mean(0), features[:, :-1].std(0)
    scaled = np.c_[(features[:, :-1] - mean) / scale, np.ones(len(features))]
    target, weights = np.eye(4)[shapes], np.zeros((9, 4))
    for _ in range(20_000):
        logits = scaled @ weights
        likely = np.exp(logits - logits.max(1, keepdims=True))
        likely /= likely.sum(1, keepdims=True)
        weights -= 2.0 * (scaled.T @ (likely - target) / len(scaled) + 1e-5 * weights)
    raw = weights[:-1] / scale[:, None]
    return np.vstack([raw, weights[-1] - mean @ raw]).T


if __name__ == "__main__":
    main()
