"""Checks that a scene can be simulated: no overlaps, everything within the workspace."""

from collections.abc import Iterable
from itertools import combinations

from magical.errors import InvalidSceneError
from magical.scene import Scene
from magical.scene.constants import COLLISION_SLOP
from magical.scene.solids import Solid

# Units by which bodies may overlap: the solver itself lets bodies in contact overlap by this much,
# and the published Demo scene of ClusterColour has two blocks that overlap by 0.0095.
OVERLAP_SLACK = COLLISION_SLOP
# Units by which bodies may reach into a wall: ClusterShape's TestShape keeps the Demo poses, where
# a square as the fifth block reaches 0.018 into the right wall. The simulation pushes it out.
WALL_SLACK = 2 * COLLISION_SLOP
ROUNDING = 1e-9  # units


def named_bodies(scene: Scene) -> dict[str, Solid]:
    """Robot and blocks by the names used in messages."""
    blocks = {
        f"block {i} ({b.colour} {b.shape})": Solid.of_block(b) for i, b in enumerate(scene.blocks)
    }
    return {"the robot": Solid.of_robot(scene.robot), **blocks}


def named_regions(scene: Scene) -> dict[str, Solid]:
    """Goal regions by the names used in messages."""
    return {f"region {i} ({r.colour})": Solid.of_region(r) for i, r in enumerate(scene.regions)}


def validate_scene(scene: Scene) -> None:
    """Check that no bodies overlap and that everything is within the workspace.

    Bodies may overlap by `OVERLAP_SLACK` and reach into walls by `WALL_SLACK`. Blocks and robot may
    be in regions, which have no physical effect.

    Raises:
        InvalidSceneError: the message names the bodies and the depth of the overlap, in units.
    """
    bodies = named_bodies(scene)
    check_inside(bodies, WALL_SLACK)
    check_inside(named_regions(scene), ROUNDING)
    check_apart(combinations(bodies.items(), 2), OVERLAP_SLACK)


def check_inside(solids: dict[str, Solid], slack: float) -> None:
    """Raise `InvalidSceneError` for a solid more than `slack` units beyond the workspace's edge."""
    for name, solid in solids.items():
        beyond = solid.beyond_wall()
        if beyond > slack:
            raise InvalidSceneError(
                f"scene: {name} at ({solid.pose.x:.3g}, {solid.pose.y:.3g}) reaches {beyond:.3g} "
                "units outside the workspace [-1, 1] x [-1, 1]; move it inside"
            )


def check_apart(pairs: Iterable[tuple[tuple[str, Solid], tuple[str, Solid]]], slack: float) -> None:
    """Raise `InvalidSceneError` for a pair that overlaps by more than `slack` units."""
    for (first, a), (second, b) in pairs:
        depth = a.depth(b)
        if depth > slack:
            raise InvalidSceneError(
                f"scene: {first} and {second} overlap by {depth:.3f} units, expected at most "
                f"{slack:g}; move them apart"
            )
