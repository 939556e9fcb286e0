"""The fingers' initial positions, which give their pin joints the published direction.

A pin joint pulls along the line from one anchor to the other. A finger hangs on a pin of zero
length, so initially this line is only a rounding error, normalised. Chipmunk computes it in
`preStep` of cpPinJoint.c as

    (finger + 0) - (robot + root)

with the root already rotated. This is exactly (0, 0) when the finger is placed at robot + root: the
pin has no direction and does not act in the first substep. pymunk 5.6.0, used by the published
environments, was compiled with -ffast-math, and its library adds the same four terms in the order

    ((finger - robot) + 0) - root

which is not zero but exactly the rounding error of robot + root. Its direction decides how the
robot starts to move, and the first step differs by some 1e-4 units.

Here the finger is displaced by a multiple of that error, so that the first expression has the
published direction as well. The error is at most half the spacing of floating-point numbers at the
finger, which therefore can only be displaced by a multiple of the error that is a whole number of
spacings. A power of two times the error has its direction to the last bit. The smallest such power
is used, because the pin now has a length, unlike the published one, and the effect of that length
grows with it.

A factor of 64 is enough for a robot whose coordinates are 0 or above 2**-7: these and the rotated
root, as floating-point numbers, are multiples of 2**-59, and the spacing at the finger is at most
2**-53 anywhere in the workspace.
"""

import pymunk

from magical.scene.geometry import Point, rotate
from magical.scene.scene import Pose

# Enough for a robot whose coordinates are 0 or above 2**-16 units. For others the direction is
# rounded to about one part in 4096, which matters less than a longer pin.
_MAX_POWER = 12


def published_error(root: Point, pose: Pose) -> Point:
    """The vector between a pin joint's anchors at the start, as pymunk 5.6.0 computes it.

    Args:
        root: where the finger is attached, in the robot's frame.
        pose: the robot's pose.

    Returns:
        The rounding error of `pose` + rotated `root`, some 1e-17 units; often 0 in a coordinate.
    """
    root_x, root_y = rotate(root, pose.angle)
    finger_x, finger_y = pose.x + root_x, pose.y + root_y
    return (finger_x - pose.x) - root_x, (finger_y - pose.y) - root_y


def finger_position(body: pymunk.Body, root: Point, pose: Pose) -> Point:
    """The initial position of a finger: its root in the workspace, displaced by some 1e-15 units.

    A pin joint made afterwards takes this displacement as its length and is at rest.

    Args:
        body: the robot's, already at `pose`.
        root: where the finger is attached, in the robot's frame.
        pose: the robot's pose.
    """
    x, y = body.local_to_world(root)  # as Chipmunk computes it, which is what the pin subtracts
    error_x, error_y = published_error(root, pose)
    for power in range(_MAX_POWER + 1):
        step_x, step_y = 2**power * error_x, 2**power * error_y
        start = x + step_x, y + step_y
        if start[0] - x == step_x and start[1] - y == step_y:
            break
    return start
