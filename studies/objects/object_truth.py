"""What object-bc loses to perception, to the choice of goals and to control.

python studies/objects/object_truth.py RUN [--variants Demo All] [--rollouts 30] [--tasks FindDupe]

Each of the three parts is replaced by the truth in turn, then all but one, then all: true poses in
place of parsed ones; the scripted expert's move (which block, where to) in place of the goal
model's; the expert's driving and carrying in place of the controller's. What a row gains over the
first is what the part costs.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.envs import EnvId
from magical.evaluation import environments, evaluate
from magical.evaluation.policy import Actions, Mask
from magical.evaluation.protocol import NUDGE
from magical.experts.expert import Expert, expert_for
from magical.experts.memory import Memory, note_other_action
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.observe.pixels import STACK
from magical.render import Renderer
from magical.scene import State, View
from magical.scene.constants import FRAME_SIZE
from magical.scene.poses import FINGERS, FIRST_BLOCK
from magical.scene.vocabulary import COLOURS, SHAPES
from magical.tasks import get_task
from magical_baselines.policy import TrainedPolicy, choose_actions, load_policy
from magical_goals.object_bc import ObjectPolicy
from magical_goals.objects.control import ROBOT_TARGET, ObjectTable, to_table, to_tensor
from magical_goals.objects.parser import FAR, MAX_BLOCKS, MAX_REGIONS, parse_frames

PARTS = ("perception", "goals", "control")
NOTHING = "nothing"
TOLERANCE = 0.03  # units: where the expert's skills leave a block
SAME_PLACE = 0.05  # units: a destination that moved by less is the same move


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", help="a run folder of object-bc")
    parser.add_argument("--tasks", nargs="+", help="default: the policy's")
    parser.add_argument("--variants", nargs="+", default=["Demo", "All"])
    parser.add_argument("--rollouts", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0, help="which set of fixed seeds")
    parser.add_argument("--truths", nargs="+", help="such as nothing goals+control; default: all")
    args = parser.parse_args()
    torch.set_num_threads(1)
    subsets = [set(c) for n in range(len(PARTS) + 1) for c in combinations(PARTS, n)]
    if args.truths:
        subsets = [set(text.split("+")) - {NOTHING} for text in args.truths]
    if unknown := set().union(*subsets) - set(PARTS):
        parser.error(f"--truths: expected {', '.join((NOTHING, *PARTS))}, found {sorted(unknown)}")
    policy = load_policy(args.run, device="cpu")
    tasks = args.tasks or policy.tasks
    print("| True | Variant | " + " | ".join(tasks) + " | mean |")
    print("| --- " * (len(tasks) + 3) + "|")
    for truths in subsets:
        for variant in args.variants:
            show(PartlyTruePolicy(policy, truths), tasks, variant, args)


def show(
    policy: "PartlyTruePolicy", tasks: Sequence[str], variant: str, args: argparse.Namespace
) -> None:
    """Print a row of mean scores."""
    scores = evaluate(
        policy,
        environments(tasks, [variant]),
        rollouts=args.rollouts,
        seed=args.seed,
        nudge=NUDGE,
        workers=1,
    )
    means = [np.mean([s.score for s in scores if s.env_id.task == task]) for task in tasks]
    cells = " | ".join(f"{mean:.2f}" for mean in (*means, np.mean(means)))
    print(f"| {' + '.join(sorted(policy.truths)) or NOTHING} | {variant} | {cells} |", flush=True)


class PartlyTruePolicy:
    """A trained `object-bc` some of whose parts are replaced by the truth."""

    privileged = True

    def __init__(self, policy: TrainedPolicy, truths: Iterable[str]) -> None:
        self.truths = set(truths)
        self.tasks = policy.tasks
        network = policy.network
        if not isinstance(network, ObjectPolicy):
            raise SystemExit("expected a run of object-bc")
        self._network = network
        self._episodes: list[ExpertEpisode | None] = []

    def reset(self, mask: Mask) -> None:
        """Forget the episodes that begin again."""
        if len(mask) != len(self._episodes):
            self._episodes = [None] * len(mask)
        for row in np.flatnonzero(mask):
            self._episodes[row] = None

    @torch.inference_mode()
    def act(
        self, observations: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
        """One action for each state."""
        seeds = rng.integers(2**31, size=len(env_ids))
        for row, (state, env_id) in enumerate(zip(observations, env_ids, strict=True)):
            if self._episodes[row] is None:
                self._episodes[row] = ExpertEpisode(env_id.task, state, int(seeds[row]))
        episodes = [episode for episode in self._episodes if episode is not None]
        tasks = torch.tensor([self.tasks.index(env_id.task) for env_id in env_ids])
        if "perception" in self.truths:
            table = _true_table(observations)
        else:
            frames = np.empty((len(episodes), FRAME_SIZE, FRAME_SIZE, 3), np.uint8)
            for frame, episode, state in zip(frames, episodes, observations, strict=True):
                episode.renderer.render(state.poses.bodies, frame)
            table = to_table(parse_frames(frames))
        for episode, pose in zip(episodes, table.robot.double().numpy(), strict=True):
            episode.note_pose(pose)
        targets, destinations = self._network.goals.decide(table, tasks)
        shadows = [e.shadow(state) for e, state in zip(episodes, observations, strict=True)]
        if "goals" in self.truths:
            targets, destinations = _expert_goals(table, observations, episodes)
        before = torch.from_numpy(np.stack([episode.pose_before for episode in episodes])).float()
        logits = self._network.control(table, before, targets, destinations)
        actions = choose_actions(logits.double().softmax(dim=1).numpy(), rng)
        if "control" in self.truths:
            places = table.blocks[torch.arange(table.size), targets.clamp(min=0)]
            for row, episode in enumerate(episodes):
                target = None if targets[row] == ROBOT_TARGET else places[row].numpy()
                goal = destinations[row].tolist()
                actions[row] = episode.pursue(observations[row], target, (goal[0], goal[1]))
        for episode, shadow, action in zip(episodes, shadows, actions.tolist(), strict=True):
            episode.note_executed(shadow, action)
        return actions


class ExpertEpisode:
    """The expert of an episode, beside the policy, and what renders its scene."""

    def __init__(self, task: str, state: State, seed: int) -> None:
        self.renderer = Renderer(state.scene, View.ALLO)
        self._expert = expert_for(task, seed=seed)
        self._memory = Memory()
        self._poses: list[NDArray[np.float64]] = []
        strategy = Strategy.sample(np.random.default_rng(seed))
        self._move: Move | None = None
        self._driver = Expert(get_task(task), Planner(self._plan), strategy)
        self._driving = Memory()

    @property
    def move(self) -> Move | None:
        """What the expert would do now."""
        return self._memory.move

    def shadow(self, state: State) -> int:
        """The expert's own action."""
        action, self._memory = self._expert.act(state, self._memory)
        return action

    def note_pose(self, pose: NDArray[np.float64]) -> None:
        """Record the robot's pose in the newest frame, true or as the policy sees it."""
        self._poses = [*self._poses[1 - STACK :], pose]

    @property
    def pose_before(self) -> NDArray[np.float64]:
        """The robot's pose in the oldest frame of the stack."""
        return self._poses[0]

    def note_executed(self, shadow: int, action: int) -> None:
        """Tell the expert what was executed in place of its action."""
        if action != shadow:
            self._memory = note_other_action(self._memory, action)

    def pursue(
        self, state: State, target: NDArray[np.float64] | None, goal: tuple[float, float]
    ) -> int:
        """The expert's driving and carrying towards another's goal."""
        block = None
        if target is not None:
            blocks = state.poses.bodies[FIRST_BLOCK:, :2]
            block = int(np.linalg.norm(blocks - target, axis=1).argmin())
        move = self._move
        if (
            move is None
            or move.block != block
            or np.hypot(*np.subtract(move.goal, goal)) > SAME_PLACE
        ):
            self._move = Move(goal, TOLERANCE, block)
            held = self._driving.held_steps if move is not None and move.block == block else 0
            self._driving = Memory(move=self._move, held_steps=held)
        self._driving = replace(self._driving, idle_steps=0)
        action, self._driving = self._driver.act(state, self._driving)
        return action

    def _plan(self, view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
        move = self._move
        assert move is not None
        place = view.position if move.block is None else view.resting_blocks[move.block]
        if np.hypot(*np.subtract(place, move.goal)) < move.tolerance:
            return MovePlan()
        return MovePlan((move,))


def _true_table(states: Sequence[State]) -> ObjectTable:
    """The scenes of true states."""
    count = len(states)
    robot, fingers = np.zeros((count, 3)), np.zeros((count, 2))
    blocks = np.full((count, MAX_BLOCKS, 2), FAR)
    colours, shapes = (np.full((count, MAX_BLOCKS), -1) for _ in range(2))
    regions = np.full((count, MAX_REGIONS, 4), FAR)
    region_colours = np.full((count, MAX_REGIONS), -1)
    for k, state in enumerate(states):
        bodies, scene = state.poses.bodies, state.scene
        robot[k] = bodies[0]
        left, right = bodies[FINGERS, 2]
        fingers[k] = left - robot[k, 2], robot[k, 2] - right
        number = len(scene.blocks)
        blocks[k, :number] = bodies[FIRST_BLOCK:, :2]
        colours[k, :number] = [COLOURS.index(block.colour) for block in scene.blocks]
        shapes[k, :number] = [SHAPES.index(block.shape) for block in scene.blocks]
        for m, region in enumerate(scene.regions):
            regions[k, m] = *region.centre, region.width / 2, region.height / 2
            region_colours[k, m] = COLOURS.index(region.colour)
    columns = robot, fingers, blocks, colours, shapes, regions, region_colours
    return ObjectTable(*map(to_tensor, columns))


def _expert_goals(
    table: ObjectTable, states: Sequence[State], episodes: Sequence[ExpertEpisode]
) -> tuple[Tensor, Tensor]:
    """The experts' moves as targets (B,) and destinations (B, 2)."""
    targets = torch.full((len(states),), ROBOT_TARGET)
    destinations = table.robot[:, :2].clone()
    for row, (state, episode) in enumerate(zip(states, episodes, strict=True)):
        move = episode.move
        if move is None:
            continue
        destinations[row] = torch.tensor(move.goal)
        if move.block is not None:
            place = torch.tensor(state.poses.bodies[FIRST_BLOCK + move.block, :2])
            targets[row] = (table.blocks[row] - place).norm(dim=1).argmin()
    return targets, destinations


if __name__ == "__main__":
    main()
