"""Goals of MoveToRegion: the robot's centre inside the region (appendix A.2.2)."""

from magical.experts.geometry import FACING_LIMIT
from magical.experts.goals._moves import inset, preferred_point
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView

DONE = 0.06  # units inside the edge: deep enough to stay inside; tuned
DEPTH = 0.09  # units inside the edge where the move ends; tuned
DEPTH_RANGE = 0.15  # units added at most; tuned
OVERSHOOT = 0.05  # units from there to the goal, so that the robot does not stop short; tuned
TOLERANCE = 0.06  # units; tuned


def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """Drive to a preferred point of the region."""
    region = view.scene.regions[0]
    if inset(region, DONE).contains(*view.position):
        return MovePlan()
    depth = DEPTH + DEPTH_RANGE * strategy.placements[2]
    x, y = preferred_point(strategy, inset(region, depth + OVERSHOOT), 0)
    goal = _reachable(x), _reachable(y)
    return MovePlan((Move(goal, TOLERANCE, area=inset(region, depth)),))


def _reachable(coordinate: float) -> float:
    """The nearest coordinate at which the open fingers do not meet a wall.

    Pushing against a wall would look like being stuck, and the robot would back out of the region.
    """
    return min(max(coordinate, -FACING_LIMIT), FACING_LIMIT)


PLANNER = Planner(plan)
