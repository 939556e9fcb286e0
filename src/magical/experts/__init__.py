"""Scripted experts: closed-loop demonstrators of every task, from any state.

Strategy. A task's goals turn the present state into a plan: the moves that are still to make, each
of one block (or of the robot itself) to a goal. The expert picks the move that takes the fewest
control steps, carries it out with a few skills, and plans again. It never looks ahead in the
simulator, and its whole state is in a `Memory` that may be dropped at any step. A
`Strategy`, sampled once per episode, adds small preference costs of sides, blocks and places, so
that demonstrators differ.

One decision (`Expert.act`):
    1. Unpack the state (`StateView`). If the robot has not moved or progressed for too long, give
       the move up and drive away for a few steps (escape).
    2. If there is no move, the move is done, or the task is solved: plan again and choose a move,
       by the steps that grasping and carrying take, blocks in the way, and earlier failures. With
       nothing left to do, back off all blocks and keep the fingers closed.
    3. If the block is between the fingers, close them (grip), then carry it: score all short
       motions under a motion model, and take the first action of the best.
    4. Otherwise approach: every few steps compare the sides from which the block can be grasped;
       drive to the gate behind the best one, around other blocks (travel), then straight ahead.
    5. Below skill 1, action noise perturbs the action, and some moves.
Where another action than its own is executed (perturbed demonstrations, DAgger), the expert takes
over from the next state.

Where it fails. Mostly in the Cluster tasks' CountPlus and All variants: with nine or ten blocks the
fingers push neighbours aside, blocks enclosed by walls and others take several attempts, and time
runs out with one or two blocks out of place. In MakeLine and the region tasks with random layouts
a neighbour may be scooped up with a block, or two blocks wedged into a corner. The costs are rules
of thumb: contacts, block shapes and angles are not modelled. Scores are in docs/benchmarks.md.

Files, from below:
    state_view, array_geometry, distances   a state as floats, plane geometry, shared distances
    motions, paths                          model of robot and held block; paths around blocks
    planning                                moves, plans, strategies, goals
    goals/                                  one file of goals per task, found by its name; helpers
    grasp, grasp_costs                      geometry of a grasp; what each side costs
    steering, carry                         the skills: travel, approach, back off, escape; carry
    memory, expert, action_noise            progress and giving up; the decision; lower skill
    perturbation, rollout                   random actions that are recovered from; whole episodes

Constants are grouped by skill in frozen `...Settings`, each with its unit and how it was found:
"geometry" follows from the sizes of robot and blocks; "measured" was read off the simulator;
"swept" is the best of a grid of values by expert scores over many environments; "tuned" was set by
hand on expert scores, most of them on the Cluster tasks and MakeLine; "for time" trades computing
time for quality. None was set on the seeds that docs/benchmarks.md reports.
"""

from magical.experts.expert import Expert, expert_for
from magical.experts.goals import get_goals, register_goals
from magical.experts.memory import Memory
from magical.experts.planning import Goals, Move, Plan, Strategy
from magical.experts.rollout import (
    EpisodeExpert,
    ExpertEpisode,
    check_solvable,
    modules_of,
    rollout,
)
from magical.experts.state_view import StateView

__all__ = [
    "EpisodeExpert",
    "Expert",
    "ExpertEpisode",
    "Goals",
    "Memory",
    "Move",
    "Plan",
    "StateView",
    "Strategy",
    "check_solvable",
    "expert_for",
    "get_goals",
    "modules_of",
    "register_goals",
    "rollout",
]
