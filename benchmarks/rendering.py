"""Times the rendering of a frame and its parts.

python benchmarks/rendering.py [--tasks ClusterColour FixColour] [--size 96] [--repeats 3000]

Prints microseconds, one line for each Demo scene and view. The first columns are whole calls: a
frame (fastest and median), a frame rendered into a stack of four that is shifted in place, creating
a renderer (once per episode). The others are the parts of a frame: the robot on the workspace, the
regions, the blocks, writing the pixels to the output, and Python (checks). The allocentric
ground is rendered once per scene, the egocentric one in every frame. Except for the median, every
figure is the fastest of many calls, as other processes can only make calls slower.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magical.render import Renderer, default_samples, warm_up
from magical.render.kernel import write
from magical.scene import Poses, Scene, View
from magical.tasks import TASKS, get_task

COLUMNS = (
    "frame", "median", "stacked", "renderer", "robot", "regions", "blocks", "output", "python",
)  # fmt: skip


def microseconds(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """The times of the fastest and the median call."""
    times = np.empty(repeats)
    for i in range(repeats):
        start = time.perf_counter()
        call()
        times[i] = time.perf_counter() - start
    return float(times.min()) * 1e6, float(np.median(times)) * 1e6


def compiled(scene: Scene, view: View, size: int, repeats: int) -> float:
    """The time of drawing, without the output."""
    renderer = Renderer(scene, view, size)
    bodies = Poses.at_rest(scene).bodies
    renderer.render(bodies, np.empty((size, size, 3), np.uint8))
    return microseconds(lambda: renderer._draw(bodies), repeats)[0]


def measure(scene: Scene, view: View, size: int, repeats: int) -> list[float]:
    """The values of one line, in the order of `COLUMNS`."""
    renderer = Renderer(scene, view, size)
    bodies = Poses.at_rest(scene).bodies
    stack = np.zeros((size, size, 12), np.uint8)
    newest = stack[:, :, -3:]
    frame, median = microseconds(lambda: renderer.render(bodies, newest), repeats)
    stacked, _ = microseconds(lambda: renderer.render_stacked(bodies, stack), repeats)
    created, _ = microseconds(lambda: Renderer(scene, view, size), max(1, repeats // 10))
    pixels = renderer._draw(bodies)
    output, _ = microseconds(lambda: write(pixels, newest), repeats)
    bare, unblocked = replace(scene, blocks=(), regions=()), replace(scene, blocks=())
    parts = [compiled(s, view, size, repeats) for s in (bare, unblocked, scene)]
    regions, blocks = np.diff(parts).tolist()
    python = frame - output - parts[-1]
    return [frame, median, stacked, created, parts[0], regions, blocks, output, python]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), metavar="TASK")
    parser.add_argument("--size", type=int, default=96, help="pixels (default: 96)")
    parser.add_argument("--repeats", type=int, default=3000, help="calls (default: 3000)")
    args = parser.parse_args()
    scenes = {name: get_task(name).demo for name in args.tasks}
    samples = default_samples(args.size)
    start = time.perf_counter()
    warm_up(samples)
    print(f"compiled or loaded in {time.perf_counter() - start:.2f} s; {args.size} x {args.size}")
    print(f"{f'pixels of {samples} x {samples} samples':20}", *(f"{c:>8}" for c in COLUMNS))
    for name, scene in scenes.items():
        for view in View:
            figures = measure(scene, view, args.size, args.repeats)
            print(f"{f'{name} {view}':20}", *(f"{figure:8.1f}" for figure in figures))


if __name__ == "__main__":
    main()
