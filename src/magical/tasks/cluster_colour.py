"""ClusterColour: push the blocks into clusters of the same colour (appendix A.2.7).

The score rises linearly from 0 to 1 as the fraction of correctly clustered blocks rises from 0.5
to 1. A block is correctly clustered when its squared distance to the centroid of its own colour is
less than a third of that to the nearest centroid of another colour. The published code has a
different rule (docs/specification.md, section 9).

Horizon: 320 control steps (the published code and the human demonstrations: 240).

Variants: all.

- Jitter, Layout: poses of robot and blocks.
- Colour, Shape: each of the four values at least once, the rest uniform, in random order.
- CountPlus: 7 to 10 blocks, with Layout, Colour and Shape.
- Dynamics: forces only. All: CountPlus and Dynamics.
"""

from magical.scene import COLOURS, Block, Colour, Pose, Scene, Shape
from magical.tasks import clustering

DEMO = Scene(
    robot=Pose(0.71692, -0.34374, 0.83693),
    blocks=(
        Block(Shape.CIRCLE, Colour.BLUE, Pose(-0.5147, 0.14149, -0.38871)),
        Block(Shape.STAR, Colour.BLUE, Pose(-0.1347, -0.71414, 1.0533)),
        Block(Shape.SQUARE, Colour.BLUE, Pose(-0.74247, -0.097592, 1.1571)),
        Block(Shape.PENTAGON, Colour.GREEN, Pose(-0.077363, -0.42964, -0.64379)),
        Block(Shape.PENTAGON, Colour.GREEN, Pose(0.51978, 0.1853, -1.1762)),
        Block(Shape.SQUARE, Colour.RED, Pose(-0.5278, -0.21642, 2.9356)),
        Block(Shape.STAR, Colour.YELLOW, Pose(-0.54039, 0.48292, 0.072818)),
        Block(Shape.PENTAGON, Colour.YELLOW, Pose(-0.16761, 0.64303, -2.3255)),
    ),
)

TASK = clustering.make_task("colour", DEMO, COLOURS)
