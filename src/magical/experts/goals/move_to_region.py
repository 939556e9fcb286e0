"""Goals of MoveToRegion: the robot's centre inside the region (appendix A.2.2)."""

from dataclasses import dataclass

from magical.experts.distances import FACING_LIMIT
from magical.experts.goals._regions import inset, missing_parts, preferred_point
from magical.experts.planning import Goals, Move, Plan, Strategy
from magical.experts.state_view import StateView


@dataclass(frozen=True, slots=True)
class MoveToRegionSettings:
    """How far inside the region the robot stops, in units."""

    done: float = 0.06  # from the edge: deep enough to stay inside; tuned
    depth: float = 0.09  # from the edge, where the move ends; tuned
    depth_range: float = 0.15  # that is added at most; tuned
    overshoot: float = 0.05  # from there to the goal, so that it does not stop short; tuned
    tolerance: float = 0.06  # tuned


SETTINGS = MoveToRegionSettings()


def plan(view: StateView, strategy: Strategy, last: Plan) -> Plan:
    """Drive to a preferred point of the region."""
    region = view.scene.regions[0]
    if inset(region, SETTINGS.done).contains(*view.position):
        return Plan()
    depth = SETTINGS.depth + SETTINGS.depth_range * strategy.placements[2]
    x, y = preferred_point(strategy, inset(region, depth + SETTINGS.overshoot), 0)
    goal = _reachable(x), _reachable(y)
    return Plan((Move(goal, SETTINGS.tolerance, area=inset(region, depth)),))


def _reachable(coordinate: float) -> float:
    """The nearest coordinate at which the open fingers do not meet a wall.

    Driving on at a wall would look like being stuck, and the robot would back out of the region.
    """
    return min(max(coordinate, -FACING_LIMIT), FACING_LIMIT)


GOALS = Goals(plan, unsolvable_fn=lambda scene: missing_parts(scene, regions=1, blocks=0))
