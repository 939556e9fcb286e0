"""A task of your own, registered from outside the package.

`Separate`: two blocks start side by side; push them at least one unit apart. Registering it
gives environment ids with every preset, an entry in `magical.TASKS`, evaluation and variants, all
from one `Task`. Import this module, and `magical/Separate-TestJitter-LoRes4E-v0` is there.
"""

import math
from dataclasses import replace

import gymnasium
import numpy as np

import magical
from magical.evaluation import environments, evaluate, load_policy, summarise
from magical.scene import Block, Colour, Pose, Poses, Scene, Shape
from magical.tasks import Axis, Task
from magical.tasks.axes import name_blocks, sample_attributes
from magical.tasks.scoring import positions

APART = 1.0  # units

DEMO = Scene(
    robot=Pose(0.0, -0.7, 0.0),
    blocks=(
        Block(Shape.SQUARE, Colour.RED, Pose(-0.15, 0.0, 0.0)),
        Block(Shape.CIRCLE, Colour.GREEN, Pose(0.15, 0.0, 0.0)),
    ),
)


def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
    """Sample each block's colour and shape."""
    return replace(scene, blocks=sample_attributes(scene.blocks, axes, rng))


def score(scene: Scene, poses: Poses) -> float:
    """The distance between the two blocks: 1 from `APART` on, 0 for that of the start, linear."""
    start = math.dist(scene.blocks[0].pose[:2], scene.blocks[1].pose[:2])
    now = math.dist(*positions(scene, poses))
    return min(max((now - start) / (APART - start), 0.0), 1.0)


def instruction(scene: Scene) -> str:
    """What to do, in English."""
    return f"Push {name_blocks(scene.blocks)} apart."


TASK = Task(
    name="Separate",
    summary="Push the two blocks apart.",
    horizon=60,
    demo=DEMO,
    axes=Axis.JITTER | Axis.COLOUR | Axis.SHAPE | Axis.DYNAMICS,
    randomise_fn=randomise,
    score_fn=score,
    instruction_fn=instruction,
    max_blocks=2,
    max_regions=0,
)
magical.register_task(TASK)


def main(rollouts: int = 20) -> None:
    """Make one environment, then evaluate the random policy on all variants."""
    env = gymnasium.make("magical/Separate-TestColour-LoRes4E-v0")
    observation, _ = env.reset(seed=0)
    print(f"{TASK.name}: observations {observation.shape}, variants {', '.join(TASK.variants)}")
    # Worker processes import tasks from their modules, never from the main script: no workers here.
    scores = evaluate(
        load_policy("random"), environments(["Separate"]), rollouts=rollouts, workers=0
    )
    for variant, summary in summarise(scores).items():
        print(f"{variant:10} {summary['mean']:.2f}")


if __name__ == "__main__":
    main()
