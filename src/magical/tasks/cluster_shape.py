"""ClusterShape: push the blocks into clusters of the same shape (appendix A.2.7)."""

from magical.scene import Block, Colour, Pose, Scene, Shape
from magical.tasks import clustering

DEMO = Scene(
    robot=Pose(0.286, -0.202, -1.878),
    blocks=(
        Block(Shape.SQUARE, Colour.YELLOW, Pose(-0.414, 0.297, -1.731)),
        Block(Shape.PENTAGON, Colour.BLUE, Pose(0.068, 0.705, 2.184)),
        Block(Shape.PENTAGON, Colour.RED, Pose(0.821, 0.220, 0.650)),
        Block(Shape.PENTAGON, Colour.RED, Pose(-0.461, -0.749, -2.673)),
        Block(Shape.CIRCLE, Colour.GREEN, Pose(0.867, -0.149, -2.215)),
        Block(Shape.STAR, Colour.YELLOW, Pose(-0.785, -0.140, -0.405)),
        Block(Shape.STAR, Colour.BLUE, Pose(-0.305, -0.226, 1.341)),
        Block(Shape.CIRCLE, Colour.GREEN, Pose(0.758, -0.708, -2.140)),
    ),
)

TASK = clustering.make_task("shape", DEMO)
