"""Whatever scene and poses it is given, the renderer stays within its arrays, and comes back.

    NUMBA_BOUNDSCHECK=1 python -m tests.render.test_fuzz COUNT

With the variable, every access of compiled code beyond an array is an IndexError.
"""

import os
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from magical.errors import MagicalError
from magical.render import Renderer
from magical.scene import Scene, View
from tests.render.cases import random_case

MUTANTS = 200
NUMBERS = (-0.0, 5e-324, 1e-300, 1e-9, 0.5, 1.02, np.pi, 2.04, 17.0, 1e3, 1e6, 1.1e6, 1e154)
EXTREMES = (*NUMBERS, 1.7e308, np.inf, np.nan)


def extreme(rng: np.random.Generator) -> float:
    return float(rng.choice(EXTREMES)) * int(rng.choice((-1, 1)))


def mutated(scene: Scene, rng: np.random.Generator) -> Scene:
    """With an extreme number in a region or a block, or many more of them."""
    regions, blocks = list(scene.regions), list(scene.blocks)
    match rng.integers(4):
        case 0 if regions:
            name = str(rng.choice(["x", "y", "width", "height"]))
            regions[0] = replace(regions[0], **{name: extreme(rng)})
        case 1 if blocks:
            blocks[0] = replace(blocks[0], pose=blocks[0].pose._replace(x=extreme(rng)))
        case 2:
            regions *= int(rng.integers(1, 15))
        case _:
            blocks *= int(rng.integers(1, 15))
    return replace(scene, regions=tuple(regions), blocks=tuple(blocks))


def outcome(number: int) -> str:
    """What becomes of one mutant: `rendered` or `refused`."""
    rng = np.random.default_rng(number)
    scene, poses = random_case(number)
    size, channels = int(rng.choice((1, 2, 7, 33, 64))), 3 * int(rng.integers(1, 6))
    view, samples = rng.choice(list(View)), int(rng.choice((1, 4)))
    try:
        scene = mutated(scene, rng)
        bodies = np.resize(poses.bodies, (5 + len(scene.blocks), 3))
        for _ in range(rng.integers(3)):
            bodies[tuple(rng.integers(bodies.shape))] = extreme(rng)
        renderer = Renderer(scene, view, size, samples, bool(rng.integers(2)))
        renderer.render_stacked(bodies, np.zeros((size, size, channels), np.uint8))
    except MagicalError:
        return "refused"
    return "rendered"


def test_mutants_are_rendered_or_refused(root: Path, tmp_path: Path) -> None:
    options = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "0", "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "tests.render.test_fuzz", str(MUTANTS)]
    environment = os.environ | options  # not optimised, it compiles faster
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rendered, refused = map(int, done.stdout.split())
    assert rendered + refused == MUTANTS
    assert min(rendered, refused) > MUTANTS / 5


if __name__ == "__main__":
    found = Counter(map(outcome, range(int(sys.argv[1]))))
    print(found["rendered"], found["refused"])
