"""Goals as programs: which programs of the goal language explain the demonstrations, and act so.

1. Frames are parsed and demonstrations cut into carries, as in `object-bc`.
2. Programs of the language of goals are enumerated by their prior probability, and weighted by the
   likelihood of the carries under a softly rational demonstrator (`magical.learning.intent`).
3. In an episode the posterior decides what is moved next, and where to; the controller of
   `object-bc` moves it. Where no program explains the demonstrations, or none that does fits the
   scene, the goal model of `object-bc` decides.

Sources: Lázaro-Gredilla et al., "Beyond imitation: zero-shot task transfer on robots by learning
concepts as cognitive programs", Science Robotics 2019; Silver et al., "Few-shot Bayesian imitation
learning with logical program policies", AAAI 2020. There are no published settings.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.errors import CheckpointError, RunFolderError
from magical.evaluation.policy import Actions, Mask
from magical.learning.algorithms import Algorithm
from magical.learning.algorithms.object_bc import (
    ObjectBCConfig,
    ObjectBCTrainer,
    ObjectPolicy,
    initialised,
    stacked_frames,
)
from magical.learning.data.expert_data import TaskTrajectories, load_demonstrations
from magical.learning.intent.acting import Intention
from magical.learning.intent.posterior import Belief, Explanation, infer
from magical.learning.intent.scenes import parsed_episode, parsed_poses, parsed_scene
from magical.learning.objects.data import ObjectData, parse_trajectory
from magical.learning.objects.hindsight import ROBOT_TARGET, track
from magical.learning.objects.parser import ParsedFrames, parse_frames
from magical.learning.objects.table import ObjectTable, to_tensor
from magical.learning.policy import TrainedPolicy, choose_actions, to_inputs
from magical.learning.running.devices import choose_device, one_thread
from magical.learning.running.loading import load_policy
from magical.learning.running.run import Run
from magical.learning.running.streams import Purpose, seeded_init, stream
from magical.messages import quoted
from magical.observe.pixels import STACK
from magical.scene import NOOP
from magical.tasks.programs import parse

MAX_BYTES = 1 << 16  # of a task's programs as text


@dataclass(frozen=True, kw_only=True)
class ProgramBCConfig(ObjectBCConfig):
    """Settings of cloning by programs."""

    seconds_each: ClassVar[tuple[float, float] | None] = 1.2e-4, 5e-3  # measured

    algorithm: str = "program-bc"


class ProgramNetwork(ObjectPolicy):
    """An object-centred policy with a belief about each task's program."""

    beliefs: Tensor  # (tasks, MAX_BYTES) uint8: JSON, filled up with zeros

    def __init__(self, config: ProgramBCConfig) -> None:
        super().__init__(config)
        empty = torch.zeros(len(config.tasks), MAX_BYTES, dtype=torch.uint8)
        self.register_buffer("beliefs", empty)

    def believe(self, task: int, belief: Belief) -> None:
        """Keep what is believed of a task."""
        programs = [[repr(program), weight] for program, weight in belief.explanations]
        text = json.dumps([programs, belief.unexplained, belief.largest]).encode()
        assert len(text) <= MAX_BYTES
        self.beliefs[task] = 0
        self.beliefs[task, : len(text)] = torch.frombuffer(bytearray(text), dtype=torch.uint8)

    def belief(self, task: int) -> Belief:
        """What is believed of a task."""
        text = bytes(self.beliefs[task].cpu().numpy()).rstrip(b"\0")
        try:
            programs, unexplained, largest = json.loads(text)
            explanations = [Explanation(parse(program), float(w)) for program, w in programs]
        except (ValueError, TypeError) as error:
            raise CheckpointError(
                f"policy: expected programs with their probabilities, found {quoted(text)}"
            ) from error
        return Belief(explanations, unexplained, largest)


class ProgramPolicy(TrainedPolicy):
    """Acts by the beliefs; remembers where each episode's blocks started, and which is which."""

    network: ProgramNetwork
    _intentions: list[Intention | None]
    _blocks: ParsedFrames  # of the last step

    def reset(self, mask: Mask) -> None:
        """Forget the episodes that end where the mask (B,) is true."""
        if mask.all():
            self._beliefs = [self.network.belief(task) for task in range(len(self.tasks))]
            self._intentions = [None] * len(mask)
        for row in np.flatnonzero(mask).tolist():
            self._intentions[row] = None

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """See `TrainedPolicy`."""
        stacks = to_inputs(observations, self._spec)
        tasks = self.task_numbers(env_ids)
        self._see(parse_frames(stacked_frames(stacks, STACK - 1)), tasks.tolist())
        before = to_tensor(parse_frames(stacked_frames(stacks, 0), robot_alone=True).robot)
        with one_thread():
            table = ObjectTable(*map(to_tensor, self._blocks))
            targets, destinations, stops = self._decide(table, tasks)
            logits = self.computed(self._control, before, targets, destinations, *table)
        actions = choose_actions(logits.softmax(dim=1).numpy(), rng, self.greedy)
        return np.where(stops, NOOP, actions)

    def _decide(
        self, table: ObjectTable, tasks: Tensor
    ) -> tuple[Tensor, Tensor, NDArray[np.bool_]]:
        """Targets (B,), destinations (B, 2), and which robots have nothing left to do (B,)."""
        targets = torch.full((table.size,), ROBOT_TARGET)
        destinations = table.robot[:, :2].clone()
        stops = np.zeros(table.size, np.bool_)
        unknown = []
        for row, intention in enumerate(self._intentions):
            if intention is None or not intention.is_known:
                unknown.append(row)
                continue
            decision = intention.decide(parsed_poses(self._blocks, row, intention.scene))
            stops[row] = decision is None
            if decision is not None:
                targets[row] = decision[0]
                destinations[row] = destinations.new_tensor(decision[1])
        if unknown:
            rows = torch.tensor(unknown)
            found = self.network.goals.decide(table.select(rows), tasks[rows])
            targets[rows], destinations[rows] = found
        return targets, destinations, stops

    def _control(self, before: Tensor, targets: Tensor, places: Tensor, *table: Tensor) -> Tensor:
        return self.network.control(ObjectTable(*table), before, targets, places)

    def _see(self, parsed: ParsedFrames, tasks: Sequence[int]) -> None:
        """Track blocks from the last step on, and begin with new episodes."""
        rows = []
        for row, intention in enumerate(self._intentions):
            now = ParsedFrames(*(column[row] for column in parsed))
            if intention is None:
                scene = parsed_scene(parsed, row)
                self._intentions[row] = Intention(self._beliefs[tasks[row]], scene)
            else:
                pair = (np.stack(both) for both in zip(self._before(row), now, strict=True))
                now = ParsedFrames(*(column[1] for column in track(ParsedFrames(*pair))))
            rows.append(now)
        self._blocks = ParsedFrames(*map(np.stack, zip(*rows, strict=True)))

    def _before(self, row: int) -> ParsedFrames:
        return ParsedFrames(*(column[row] for column in self._blocks))


def train(config: ProgramBCConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    device = choose_device(config.device)
    policy = make_policy(config)
    demonstrations = load_demonstrations(config, run)
    if not run.saved:
        for number, belief in enumerate(infer_beliefs(config, demonstrations).values()):
            policy.believe(number, belief)
    trainer = ObjectBCTrainer(config, run, policy, device)
    component = config.observation_spec.components[0]
    trainer.fit(ObjectData(demonstrations, config.tasks, component, device))


def infer_beliefs(config: ProgramBCConfig, demonstrations: TaskTrajectories) -> dict[str, Belief]:
    """What is believed of each task after its demonstrations."""
    rng = stream(config.seed, Purpose.PROGRAMS)
    component = config.observation_spec.components[0]
    beliefs = {}
    for task in config.tasks:
        episodes = [
            parsed_episode(trajectory, track(parse_trajectory(trajectory, component)), rng)
            for name, trajectory in demonstrations
            if name == task
        ]
        beliefs[task] = infer(episodes)
    return beliefs


def beliefs_of(run: Path) -> dict[str, Belief]:
    """What the policy of a run folder believes of each of its tasks.

    Raises:
        RunFolderError: not a run of this algorithm.
        CheckpointError: no checkpoint yet, or a damaged one.
    """
    policy = load_policy(run, device="cpu")
    if not isinstance(policy, ProgramPolicy):
        raise RunFolderError(
            f"{run}: expected a run of program-bc, found one of {policy.config.algorithm}"
        )
    return {task: policy.network.belief(k) for k, task in enumerate(policy.tasks)}


def make_policy(config: ProgramBCConfig) -> ProgramNetwork:
    """The policy without beliefs, initialised from the seed."""
    with seeded_init(config.seed):
        return initialised(ProgramNetwork(config), config)


ALGORITHM = Algorithm(ProgramBCConfig, train, make_policy, ProgramPolicy)
