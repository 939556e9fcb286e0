"""Goals as programs: infer which programs explain the demonstrations, and act accordingly.

Demonstrations are cut into carries, as in `object-bc`. Programs are enumerated, and weighted by
their prior probability and by the likelihood of the carries (`magical_goals.intent`). In an
episode, the posterior decides what is moved next, and where to; a planner moves it, with a motion
model fitted to the demonstrations (`magical_goals.planning`). If no program explains these, or
none of those that do fits the scene, `object-bc` decides and acts.

Sources: Lázaro-Gredilla et al., "Beyond imitation: zero-shot task transfer on robots by learning
concepts as cognitive programs", Science Robotics 2019; Silver et al., "Few-shot Bayesian imitation
learning with logical program policies", AAAI 2020. There are no published settings.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from msgspec import Meta
from torch import Tensor

from magical.errors import CheckpointError, InvalidProgramError, RunFolderError
from magical.evaluation.policy import Actions, Mask
from magical.files import parse_json
from magical.observe import STACK
from magical.scene import NOOP, ROBOT
from magical_baselines.algorithms import bc
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.config import Algorithm
from magical_baselines.data import ExpertData, TaskTrajectories, load_demonstrations
from magical_baselines.policy import TrainedPolicy, load_policy, sample_actions, to_inputs
from magical_baselines.training import Purpose, Run, anneal, gradient_step, seeded_init, stream
from magical_goals.intent.acting import Intention
from magical_goals.intent.checking import contradiction, demonstrated_ends
from magical_goals.intent.posterior import (
    Belief,
    Explanation,
    infer,
    parsed_episode,
    parsed_poses,
    parsed_scene,
)
from magical_goals.language import parse
from magical_goals.object_bc import ObjectBCConfig, ObjectBCTrainer, ObjectPolicy, stacked_frames
from magical_goals.objects.data import (
    OBSERVATION,
    ObjectData,
    ParsedDemonstration,
    parse_demonstrations,
    track,
)
from magical_goals.objects.parser import ParsedFrames
from magical_goals.planning.motion import Motion, fit_motion
from magical_goals.planning.planner import Planner, Situation

MAX_BYTES = 1 << 16  # size of a task's belief as JSON
MOTION_SHAPES = {"drive": (2, 3), "turn": (2, 2), "grasp": (3,)}  # float64: see `Motion`


@dataclass(frozen=True, kw_only=True)
class ProgramBCConfig(ObjectBCConfig):
    """Settings of behavioural cloning with goals as programs."""

    algorithm: str = "program-bc"

    @property
    def cloning(self) -> BCConfig:
        """Settings of the cloning of what no program explains."""
        own = {"tasks": self.tasks, "seed": self.seed, "demos": self.demos}
        settings = {**own, "batches": self.batches, "observation": OBSERVATION}
        return BCConfig.preset("quick", **settings)


class ProgramNetwork(ObjectPolicy):
    """An object-centred policy with a belief about the program of each task."""

    beliefs: Tensor  # (tasks, MAX_BYTES) uint8: JSON, padded with zeros

    def __init__(self, config: ProgramBCConfig) -> None:
        super().__init__(config)
        self.pixels = bc.make_policy(config.cloning)
        empty = torch.zeros(len(config.tasks), MAX_BYTES, dtype=torch.uint8)
        self.register_buffer("beliefs", empty)
        for name, shape in MOTION_SHAPES.items():
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    @property
    def motion(self) -> Motion:
        """The motion model of the robot."""
        return Motion(*(getattr(self, name).cpu().numpy() for name in MOTION_SHAPES))

    def move_as(self, motion: Motion) -> None:
        """Store the motion model of the robot."""
        for name, values in zip(MOTION_SHAPES, motion, strict=True):
            getattr(self, name).copy_(torch.from_numpy(values))

    def believe(self, task: int, belief: Belief) -> None:
        """Store the belief about a task."""
        programs = [(repr(program), weight) for program, weight in belief.explanations]
        saved = _SavedBelief(
            programs, belief.unexplained, belief.largest, belief.contradiction, list(belief.ends)
        )
        text = json.dumps(saved).encode()
        assert len(text) <= MAX_BYTES
        self.beliefs[task] = 0
        self.beliefs[task, : len(text)] = torch.frombuffer(bytearray(text), dtype=torch.uint8)

    def belief(self, task: int) -> Belief:
        """The belief about a task."""
        text = bytes(self.beliefs[task].cpu().numpy()).rstrip(b"\0")
        saved = parse_json(text, _SavedBelief, "policy", CheckpointError)
        try:
            explanations = [Explanation(parse(program), w) for program, w in saved.programs]
        except InvalidProgramError as error:
            raise CheckpointError(f"policy: {error}") from error
        belief = Belief(explanations, *saved[1:])
        if belief.is_explained and not explanations:
            raise CheckpointError(f"policy: no programs, but {saved.unexplained} unexplained")
        return belief


class _SavedBelief(NamedTuple):
    """A belief as a JSON array of these values."""

    programs: list[tuple[str, Annotated[float, Meta(gt=0)]]]  # with their weights
    unexplained: float
    largest: float
    contradiction: str = ""
    ends: list[tuple[float, float]] = []  # noqa: RUF012 (msgspec copies it)


class ProgramPolicy(TrainedPolicy):
    """Acts on the beliefs; keeps each episode's initial scene and tracks its blocks."""

    network: ProgramNetwork
    _episodes: list["_Episode | None"]

    def reset(self, mask: Mask) -> None:
        """Forget the episodes of the environments for which the mask (B,) is true."""
        if mask.all():
            self._beliefs = [self.network.belief(task) for task in range(len(self.tasks))]
            self._episodes = [None] * len(mask)
        for row in np.flatnonzero(mask).tolist():
            self._episodes[row] = None

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """See `TrainedPolicy`."""
        stacks = to_inputs(observations, self._spec)
        tasks = self.task_numbers(env_ids)
        parsed = self.network.perception(stacked_frames(stacks, STACK - 1))
        uniforms = rng.random(len(tasks))
        actions = np.full(len(tasks), NOOP)
        unknown: list[int] = []
        unexplained: list[int] = []
        for row, task in enumerate(tasks.tolist()):
            now = parsed.select(slice(row, row + 1))
            episode = self._episodes[row]
            if episode is None:
                intention = Intention(self._beliefs[task], parsed_scene(parsed, row))
                episode = _Episode(intention, Planner(self.network.motion), now)
                self._episodes[row] = episode
            else:
                episode.see(now)
            if episode.intention.is_known:
                actions[row] = episode.act(None if self.greedy else uniforms[row])
            else:
                known = self._beliefs[task].is_explained
                (unknown if known else unexplained).append(row)
        for chosen, network in ((unknown, self.network), (unexplained, self.network.pixels)):
            if not chosen:
                continue
            rows = np.array(chosen)
            inputs = stacks[rows] if network is self.network else to_unit(stacks[rows])
            logits = self.computed(network, inputs, tasks[rows])
            found = logits.softmax(dim=1).numpy()
            # Each row has its own random number, so rows do not affect each other.
            sampled = sample_actions(found, uniforms[rows])
            actions[rows] = found.argmax(axis=1) if self.greedy else sampled
        return actions


class _Episode:
    """An episode in progress."""

    def __init__(self, intention: Intention, planner: Planner, now: ParsedFrames) -> None:
        self.intention, self._planner = intention, planner
        self._now, self._before = now, now

    def see(self, parsed: ParsedFrames) -> None:
        """Take in the next frame, with blocks numbered as in the first."""
        pair = track(ParsedFrames.joined([self._now, parsed]))
        self._before, self._now = self._now, pair.select(slice(1, 2))

    def act(self, uniform: float | None) -> int:
        """See `Planner.act`; a no-op if nothing is left to do."""
        poses = parsed_poses(self._now, 0, self.intention.scene)
        decision = self.intention.decide(poses)
        if decision is None:
            return NOOP
        target, place = decision
        pose, blocks = poses.bodies[ROBOT], poses.blocks[:, :2]
        seen = Situation(pose, self._before.robot[0], blocks, target, np.array(place))
        return self._planner.act(seen, uniform)


class ProgramTrainer(ObjectBCTrainer):
    """Also clones from pixels where no program explains the demonstrations of some task."""

    policy: ProgramNetwork

    def __init__(self, config: ProgramBCConfig, run: Run, policy: ProgramNetwork) -> None:
        """Create a new trainer, or resume from the run's checkpoint."""
        self.cloning = config.cloning
        parameters = policy.to(run.compute.device).pixels.parameters()
        self.pixels_optimizer = bc.make_optimizer(self.cloning, parameters)
        super().__init__(config, run, policy, pixels_optimizer=self.pixels_optimizer)
        self._frames: ExpertData | None = None

    def clone(self, demonstrations: TaskTrajectories) -> None:
        """From now on, clone these, too."""
        spec = self.cloning.observation_spec
        tasks, device = self.config.tasks, self.device
        self._frames = ExpertData(demonstrations, tasks, spec, device=device, remove_noops=True)
        self.policy.pixels.train()

    def update(self, data: ObjectData, number: int, rng: np.random.Generator) -> dict[str, Tensor]:
        """See `ObjectBCTrainer`."""
        own = rng.spawn(1)[0]
        metrics = super().update(data, number, rng)
        if self._frames is not None:
            anneal(self.pixels_optimizer, number, self.config.num_updates)
            batch = bc.sample_batch(self.cloning, self._frames, own)
            with self.compute.autocast():
                found = bc.bc_losses(self.policy.pixels, batch)
            gradient_step(self.pixels_optimizer, found["loss"])
            metrics["pixels_loss"] = found["loss"]
        return metrics


def train(config: ProgramBCConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    policy = make_policy(config)
    trajectories = load_demonstrations(config, run)
    demonstrations = parse_demonstrations(trajectories, policy.perception)
    if not run.saved:
        policy.move_as(fit_motion(demonstrations))
        for number, belief in enumerate(infer_beliefs(config, demonstrations).values()):
            policy.believe(number, belief)
    trainer = ProgramTrainer(config, run, policy)
    if not all(policy.belief(task).is_explained for task in range(len(config.tasks))):
        trainer.clone(trajectories)
    trainer.fit(demonstrations)


def infer_beliefs(
    config: ProgramBCConfig, demonstrations: Sequence[ParsedDemonstration]
) -> dict[str, Belief]:
    """The belief about each task, from its own demonstrations and independent of other tasks."""
    beliefs = {}
    for task in config.tasks:
        rng = stream(config.seed, Purpose.PROGRAMS)
        own = [each for each in demonstrations if each.task == task]
        belief = infer([parsed_episode(each, rng) for each in own])
        if belief.is_explained:
            belief = belief._replace(contradiction=contradiction(belief, own))
        beliefs[task] = belief._replace(ends=demonstrated_ends(own))
    return beliefs


def beliefs_of(run: Path) -> dict[str, Belief]:
    """The beliefs of a run's policy, by task; raises `RunFolderError` or `CheckpointError`."""
    policy = load_policy(run, device="cpu")
    if not isinstance(policy, ProgramPolicy):
        raise RunFolderError(
            f"{run}: expected a run of program-bc, found one of {policy.config.algorithm}"
        )
    return {task: policy.network.belief(k) for k, task in enumerate(policy.tasks)}


def make_policy(config: ProgramBCConfig) -> ProgramNetwork:
    """The policy without beliefs, initialised from the seed."""
    with seeded_init(config.seed):
        return ProgramNetwork(config)


ALGORITHM = Algorithm(ProgramBCConfig, train, make_policy, ProgramPolicy)
