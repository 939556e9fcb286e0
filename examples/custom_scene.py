"""Start an episode from a scene of your own, with an expert as the policy.

Scenes are plain data: write them in Python, or as JSON that `Scene.from_dict` reads.
"""

import numpy as np

from magical.envs.env import MagicalEnv
from magical.experts import expert_for
from magical.scene import Block, Colour, Dynamics, Pose, Region, Scene, Shape

SCENE = Scene(
    robot=Pose(0.0, -0.6, 0.0),
    blocks=(
        Block(Shape.STAR, Colour.BLUE, Pose(0.5, 0.0, 0.3)),
        Block(Shape.CIRCLE, Colour.RED, Pose(-0.5, -0.1, 0.0)),
        Block(Shape.SQUARE, Colour.YELLOW, Pose(-0.05, 0.15, 0.8)),
    ),
    regions=(Region(Colour.BLUE, x=-0.4, y=0.9, height=0.5, width=0.8),),
)
SLIPPERY = Dynamics(block_pivot_max_force=1.0, block_gear_max_force=0.07)


def main() -> float:
    """Run one episode; returns its score."""
    env = MagicalEnv("MatchRegions", "Demo", observation="state")  # or gymnasium.make(...)
    env.reset(seed=0, options={"scene": SCENE, "dynamics": SLIPPERY})
    expert, memory, truncated = expert_for("MatchRegions", seed=0), None, False
    while not truncated:
        action, memory = expert.act(env.state(), memory)
        _, _, _, truncated, info = env.step(action)
    print(f"{env.task.summary} Score: {info['eval_score']:.2f}")
    for block, (x, y, angle) in zip(SCENE.blocks, env.state().poses.blocks, strict=True):
        degrees = np.rad2deg(angle)
        print(f"{block.colour} {block.shape}: now at ({x:.2f}, {y:.2f}), {degrees:.0f} degrees")
    return float(info["eval_score"])


if __name__ == "__main__":
    main()
