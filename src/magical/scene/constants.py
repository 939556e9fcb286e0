"""Every physical constant, defined once with its unit and source; derived values are computed.

Units: workspace units (the workspace is the square [-1, 1] x [-1, 1], y up), radians
(counter-clockwise positive), seconds, kilogram-like mass units. Sections refer to
docs/specification.md.
"""

import math

# Section 1: time.
CONTROL_RATE = 8.0  # Hz
SUBSTEPS = 10  # physics substeps per control step
SUBSTEP_TIME = 1.0 / (CONTROL_RATE * SUBSTEPS)  # s
SOLVER_ITERATIONS = 10
COLLISION_SLOP = 0.01  # units

# The workspace and section 4: walls.
WORKSPACE_HALF = 1.0  # units
WALL_RADIUS = 1.0  # units
WALL_DISTANCE = 1.0  # units from the workspace's edge to a wall's centre line
WALL_FRICTION = 0.8

# Section 2: robot body.
ROBOT_RADIUS = 0.2  # units
ROBOT_MASS = 1.0
ROBOT_FRICTION = 0.5
DRIVE_SPEED_FORWARD = 4.0 * ROBOT_RADIUS  # units / s
DRIVE_SPEED_BACK = -3.0 * ROBOT_RADIUS  # units / s
TURN_LEAD = 1.5  # rad by which the control body is ahead while turning
TURN_MAX_BIAS = 2.5  # rad / s

# Section 2: eyes.
EYE_MASS = 0.1
EYE_SPRING_STIFFNESS = 0.1
EYE_SPRING_DAMPING = 3e-3

# Section 2: fingers. SIDES are left (-1) and right (+1).
SIDES = (-1, 1)
FINGER_MASS = 1.0 / 8.0
FINGER_FRICTION = 5.0
FINGER_THICKNESS = 0.25 * ROBOT_RADIUS  # units
UPPER_ARM_LENGTH = 1.1 * ROBOT_RADIUS  # units
FOREARM_LENGTH = 0.7 * ROBOT_RADIUS  # units
FOREARM_BEND = math.pi / 8  # rad
FINGER_OPEN = math.pi / 8  # rad away from the closed position, outwards
FINGER_ROOT_X = 0.45 * ROBOT_RADIUS  # units, times the side
FINGER_ROOT_Y = 0.1 * ROBOT_RADIUS  # units
FINGER_GAIN = 10.0  # 1 / s: motor rate per radian of error
FINGER_MAX_RATE = 1.0  # rad / s
FINGER_DEAD_RATE = 1e-4  # rad / s: dead band, rates below are set to 0

# Section 3: blocks.
BLOCK_SIZE = 0.12  # units: radius of the disc of the same area
BLOCK_MASS = 0.5
BLOCK_FRICTION = 0.5
SQUARE_SIDE = math.sqrt(math.pi) * BLOCK_SIZE  # units
SQUARE_MARGIN = 0.01 * SQUARE_SIDE  # units: collision radius around a square
PENTAGON_SIDE = 2.0 * BLOCK_SIZE * math.sqrt(math.pi / 5 * math.tan(math.pi / 5))  # units
PENTAGON_RADIUS = PENTAGON_SIDE / (2.0 * math.sin(math.pi / 5))  # units
STAR_OUTER_RADIUS = 1.3 * BLOCK_SIZE  # units
STAR_INNER_RADIUS = 0.5 * STAR_OUTER_RADIUS  # units

# Sections 6 and 7: the resolutions of the published frames.
RAW_FRAME_SIZE = 384  # pixels: as rendered, one sample per pixel
FRAME_SIZE = 96  # pixels: after averaging 4 x 4
SAMPLES = (1, 2, 4)  # numbers of samples across a pixel that can be rendered
# Samples across a frame: at most 4096 pixels (a frame of 50 MB), or 1024 of 4 x 4 samples. A frame
# is rendered in up to 134 MB for the workspace and for each goal region.
MAX_SAMPLES_ACROSS = 4096

# Limits for a scene. No more blocks fit into the workspace; beyond these, the solver and the
# renderer take minutes.
MAX_BLOCKS, MAX_REGIONS = 100, 30

# Limit for scenes and poses, in units and radians; beyond it, the solver's results are not numbers.
MAX_COORDINATE = 1e3
