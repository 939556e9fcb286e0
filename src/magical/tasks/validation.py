"""Checks that a scene can be simulated: no overlaps, everything within the workspace."""

from magical.errors import InvalidSceneError
from magical.scene import Pose, Scene
from magical.scene.constants import COLLISION_SLOP

# Units by which bodies may overlap: the solver itself lets bodies in contact overlap by this much,
# and the published Demo scene of ClusterColour has two blocks that overlap by 0.0095.
OVERLAP_SLACK = COLLISION_SLOP
# Units by which bodies may reach into a wall: ClusterShape's TestShape keeps the Demo poses, where
# a square as the fifth block reaches 0.018 into the right wall. The simulation pushes it out.
WALL_SLACK = 2 * COLLISION_SLOP
ROUNDING = 1e-9  # units


def validate_scene(scene: Scene) -> None:
    """Check that no bodies overlap and that everything is within the workspace.

    Bodies may overlap by `OVERLAP_SLACK` and reach into walls by `WALL_SLACK`. Blocks and robot may
    be in regions, which have no physical effect.

    Raises:
        InvalidSceneError: the message names the bodies and the depth of the overlap, in units.
    """
    from magical.physics.overlap import Kind, Solid, Solids  # imports pymunk

    solids, names = Solids.cleared(), dict[Solid, str]()

    def inside(name: str, kind: Kind, pose: Pose, slack: float) -> Solid:
        solid = solids.take(kind)
        solid.move(pose)
        if solid.beyond_wall > slack:
            raise InvalidSceneError(
                f"scene: {name} at ({pose.x:.3g}, {pose.y:.3g}) reaches {solid.beyond_wall:.3g} "
                "units outside the workspace [-1, 1] x [-1, 1]; move it inside"
            )
        return solid

    for i, region in enumerate(scene.regions):
        inside(f"region {i} ({region.colour})", region, Pose(*region.centre, 0.0), ROUNDING)
    bodies: list[tuple[str, Kind, Pose]] = [("the robot", None, scene.robot)]
    for i, block in enumerate(scene.blocks):
        bodies.append((f"block {i} ({block.colour} {block.shape})", block.shape, block.pose))
    for name, kind, pose in bodies:
        solid = inside(name, kind, pose, WALL_SLACK)
        for other, depth in solids.overlaps(solid):
            if depth > OVERLAP_SLACK:
                raise InvalidSceneError(
                    f"scene: {names[other]} and {name} overlap by {depth:.3f} units, expected at "
                    f"most {OVERLAP_SLACK:g}; move them apart"
                )
        solids.place(solid)
        names[solid] = name
