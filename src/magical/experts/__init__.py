"""Scripted experts: closed-loop demonstrators of every task, from any state.

A task's planner turns the current state into the moves still to be made, each of one block (or of
the robot itself) to a goal. The expert makes the move that takes the fewest control steps, then
plans again. It never looks ahead in the simulator, and its whole state is in a `Memory` that may be
dropped at any step. A `Strategy`, sampled once per episode, adds small preference costs for sides,
blocks and places, so that demonstrators differ.

One decision, in `expert`:
    1. If the robot has not moved or progressed for too long, it gives up the move and drives away
       for a few steps (`grasp.escape`).
    2. If there is no move, the move is done, or the task is solved, it plans again (`goals`) and
       chooses a move by the steps that grasping (`grasp`) and carrying take, blocks in the way, and
       earlier failures. With nothing left to do, it backs off all blocks and closes the fingers.
    3. If the block is between the fingers, it closes them and carries the block (`carry`): it takes
       the first action of the best of all short motions under a motion model.
    4. Otherwise it approaches (`grasp.approach`): it drives to the gate behind the best side,
       around other blocks (`paths`), then straight ahead.
If an action other than its own is executed (perturbed demonstrations, DAgger), the expert takes
over from the next state.

It fails mostly in the Cluster tasks' CountPlus and All variants: with nine or ten blocks, the
fingers push neighbours aside, blocks enclosed by walls and other blocks take several attempts, and
time runs out with one or two blocks out of place. In MakeLine and the region tasks with random
layouts, a neighbour may be scooped up with a block, or two blocks may get wedged in a corner. The
costs are rules of thumb: contacts, block shapes and angles are not modelled. `magical evaluate
expert` scores the experts.

Constants are at the top of the file that uses them, each with its unit and origin: "measured" was
read off the simulator; "swept" is the best of a grid of values by expert scores over many
environments; "tuned" was set by hand on expert scores, mostly on the Cluster tasks and MakeLine;
"for time" gives up quality to save computing time. None was set on the evaluation seeds
(docs/protocol.md). The study `experts` has measured the effect of each, except those of `noise`.
"""

from magical.experts.expert import (
    EpisodeExpert,
    Expert,
    Memory,
    expert_for,
    note_other_action,
    strategy_seed,
)
from magical.experts.goals import get_planner, has_expert, register_planner
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.rollout import ExpertEpisode, modules_of, rollout
from magical.experts.state_view import StateView

__all__ = [
    "EpisodeExpert",
    "Expert",
    "ExpertEpisode",
    "Memory",
    "Move",
    "MovePlan",
    "Planner",
    "StateView",
    "Strategy",
    "expert_for",
    "get_planner",
    "has_expert",
    "modules_of",
    "note_other_action",
    "register_planner",
    "rollout",
    "strategy_seed",
]
