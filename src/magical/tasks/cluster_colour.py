"""ClusterColour: push the blocks into clusters of the same colour (appendix A.2.7)."""

from magical.scene import Block, Colour, Pose, Scene, Shape
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

TASK = clustering.make_task("colour", DEMO)
