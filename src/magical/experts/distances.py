"""Distances that several skills share; geometry first, then margins.

Constants of one skill are in the `...Settings` beside it; the package's docstring says what the
words "measured", "swept" and "tuned" in their comments mean.
"""

from magical.scene.constants import BLOCK_SIZE, ROBOT_RADIUS, WORKSPACE_HALF
from magical.scene.solids import robot_silhouette

ROBOT_LIMIT = WORKSPACE_HALF - ROBOT_RADIUS  # units: largest coordinate of the robot's centre
# units: the same with the open fingers towards the wall, at whatever angle
FACING_LIMIT = WORKSPACE_HALF - robot_silhouette().outer
CONTACT_DISTANCE = ROBOT_RADIUS + BLOCK_SIZE  # units between the centres of robot and block
DRIVING_CLEARANCE = CONTACT_DISTANCE + 0.02  # units to blocks driven past; margin tuned
HELD_DISTANCE = CONTACT_DISTANCE + 0.015  # units to a held block; measured: 0.333 to 0.364
BLOCK_SPACING = 2 * BLOCK_SIZE + 0.02  # units between two blocks side by side; margin tuned
WORKING_DISTANCE = 0.4  # units: blocks nearer than this hinder a grasp or a release; swept
