"""Renders mutated scenes and poses; whatever they are, a frame or the package's error comes out.

    NUMBA_BOUNDSCHECK=1 python -m tests.render.fuzz COUNT [FIRST]

With the variable, every access of compiled code beyond an array is an IndexError. Prints how many
mutants were rendered and refused; ends with a traceback and the mutant's number at anything else,
or after `LIMIT` seconds in one mutant.
"""

import faulthandler
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from magical.errors import MagicalError
from magical.render import Renderer
from magical.scene import Pose, Scene, View
from tests.render.cases import random_case

LIMIT = 300.0  # s; the first mutants compile
NUMBERS = (0.0, -0.0, 5e-324, 1e-300, 1e-9, 0.5, 1.02, np.pi, 2.04, 17.0, 1e3, 1e6, 1.1e6, 1e9)
EXTREMES = (*NUMBERS, 1e18, 1e19, 1e100, 1e154, 1e300, 1.7e308, np.inf, np.nan)
SIZES, SAMPLES = (1, 2, 3, 7, 33, 64, 96), (1, 2, 4)

Bodies = NDArray[np.float64]


def extreme(rng: np.random.Generator) -> float:
    return float(rng.choice(EXTREMES)) * int(rng.choice((-1, 1)))


def mutated_scene(scene: Scene, rng: np.random.Generator) -> Scene:
    """With extreme regions and block poses, or many more of them."""
    regions, blocks = list(scene.regions), list(scene.blocks)
    for _ in range(rng.integers(1, 4)):
        match rng.integers(4):
            case 0 if regions:
                name = str(rng.choice(["x", "y", "width", "height"]))
                i = int(rng.integers(len(regions)))
                regions[i] = replace(regions[i], **{name: extreme(rng)})
            case 1 if blocks:
                i = int(rng.integers(len(blocks)))
                pose = list(blocks[i].pose)
                pose[rng.integers(3)] = extreme(rng)
                blocks[i] = replace(blocks[i], pose=Pose(*pose))
            case 2:
                regions *= int(rng.integers(1, 15))
            case 3 if rng.integers(4) == 0:
                blocks *= int(rng.integers(1, 15))
    return replace(scene, regions=tuple(regions), blocks=tuple(blocks))


def mutated_bodies(bodies: Bodies, rng: np.random.Generator) -> Bodies:
    """With extreme numbers, or of another shape."""
    bodies = bodies.copy()
    for _ in range(rng.integers(4)):
        bodies[tuple(rng.integers(bodies.shape))] = extreme(rng)
    return bodies[1:] if rng.integers(20) == 0 else bodies


def render(scene: Scene, bodies: Bodies, rng: np.random.Generator) -> None:
    size, channels = int(rng.choice(SIZES)), 3 * int(rng.integers(1, 6))
    view = View.EGO if rng.integers(2) else View.ALLO
    renderer = Renderer(scene, view, size, int(rng.choice(SAMPLES)), bool(rng.integers(2)))
    renderer.render(bodies, np.zeros((size, size, 3), np.uint8))
    renderer.render_stacked(bodies, np.zeros((size, size, channels), np.uint8))


def outcome(number: int) -> str:
    """What becomes of one mutant: `rendered` or `refused`."""
    rng = np.random.default_rng(number)
    scene, poses = random_case(number)
    try:
        if rng.integers(3):
            scene = mutated_scene(scene, rng)
            extra = rng.uniform(-1.0, 1.0, (5 + len(scene.blocks), 3))
            bodies = np.concatenate([poses.bodies, extra])[: len(extra)]
        else:
            bodies = poses.bodies
        changed = mutated_bodies(bodies, rng) if rng.integers(3) else bodies
        render(scene, changed, rng)
    except MagicalError:
        return "refused"
    return "rendered"


def main(count: int, first: int = 0) -> None:
    found: Counter[str] = Counter()
    for number in range(first, first + count):
        faulthandler.dump_traceback_later(LIMIT, exit=True)
        try:
            found[outcome(number)] += 1
        except BaseException as error:
            error.add_note(f"mutant {number}")
            raise
    faulthandler.cancel_dump_traceback_later()
    print(f"{found['rendered']} rendered, {found['refused']} refused, 0 escaped")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
