"""Object-centred behavioural cloning: parse the objects, choose a goal, act towards it.

In hindsight, every recorded state gets the goal that was reached from it: which block was moved
next, and where to. A goal model learns the likelihood of those goals from relations between
objects, separately for each task, and a controller, shared by all tasks, clones the demonstrator's
actions given the goal, in the robot's frame. There are no published settings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Optimizer

from magical.errors import InvalidConfigError
from magical.observe import CHANNELS, STACK
from magical.runs import BENCHMARK_PRIOR, PARSER_SOURCES
from magical.scene import MIRRORED_ACTIONS
from magical.tasks import get_task
from magical_baselines.compute import cpu_threads
from magical_baselines.config import Algorithm, PositiveFloat, PositiveInt, SupervisedConfig, option
from magical_baselines.data import load_demonstrations
from magical_baselines.training import Purpose, Run, anneal, fit, gradient_step, seeded_init, stream
from magical_goals.objects.control import (
    ROBOT_TARGET,
    Controller,
    ObjectTable,
    control_inputs,
    to_table,
)
from magical_goals.objects.data import (
    OBSERVATION,
    ObjectData,
    ParsedDemonstration,
    parse_demonstrations,
)
from magical_goals.objects.goals import BORDER, CANDIDATES, REFITTED, GoalModel, goal_losses
from magical_goals.objects.parser import MAX_BLOCKS, MAX_REGIONS, PARSER, Pixels, get_perception

STANDS, STANDS_ANGLE = 0.01, 0.05  # units, rad: a robot that moved less over the stack stands still
WEIGHT_DECAY = 1e-2  # of the controller
DESTINATION_NOISE = 0.03  # units: standard deviation of the noise on the controller's destinations
DROPPED = 0.3  # share of blocks other than targets that are dropped from the controller's samples
TEMPERATURE, STUCK_TEMPERATURE = 0.7, 4.0  # of the softmax; a stuck robot acts more randomly
GOAL_EVERY = 8  # batches between updates of the goal model
GOAL_SPARSITY = 0.01  # weight of the goal model's group lasso; see `REFITTED`
GOAL_BATCH_SIZE = 64  # samples of each task in an update of the goal model
GOAL_LEARNING_RATE = 0.05  # initial rate of the goal model; annealed linearly to 0


@dataclass(frozen=True, kw_only=True)
class ObjectBCConfig(SupervisedConfig):
    """Settings of object-centred behavioural cloning."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {"batches": 3000, "precision": "auto"},
    }
    algorithm: str = "object-bc"
    perception: str = option(
        PARSER, "what detects the objects in frames", plugins="module:NAME", known=(PARSER,)
    )
    batches: PositiveInt = option(6000, "training batches")
    batch_size: PositiveInt = option(256, "samples per batch of the controller")
    learning_rate: PositiveFloat = option(
        2e-3, "the controller's initial learning rate; annealed linearly to 0"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for task in map(get_task, self.tasks):
            if task.max_blocks > MAX_BLOCKS or task.max_regions > MAX_REGIONS:
                raise InvalidConfigError(
                    f"{task.name}: expected at most {MAX_BLOCKS} blocks and {MAX_REGIONS} regions, "
                    f"since {self.algorithm} finds no more, found {task.max_blocks} and "
                    f"{task.max_regions}"
                )

    @property
    def observation(self) -> str:
        """See `Config`."""
        return OBSERVATION

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`; the relations, too, were chosen for these tasks."""
        return (*super().learned_from, *PARSER_SOURCES, BENCHMARK_PRIOR)


class ObjectPolicy(nn.Module):
    """Maps frame stacks to logits of the 18 actions, by way of objects and a goal."""

    takes_pixels = True

    def __init__(self, config: ObjectBCConfig) -> None:
        super().__init__()
        self.perception = get_perception(config.perception)
        self.goals = GoalModel(len(config.tasks))
        self.controller = Controller()
        blank = torch.zeros((1, *config.input_shape), dtype=torch.uint8)
        self(blank, torch.zeros(1, dtype=torch.int64))  # fixes the sizes of the lazy layers

    def forward(self, observations: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B, 18) for stacks (B, 12, 96, 96) uint8."""
        newest, oldest = (stacked_frames(observations, k) for k in (STACK - 1, 0))
        table = to_table(self.perception(newest), tasks.device)
        before = torch.from_numpy(self.perception(oldest, robot_alone=True).robot).to(table.robot)
        plain = torch.autocast(tasks.device.type, enabled=False)  # positions need float32
        with cpu_threads(1):
            with plain:
                targets, destinations = self.goals.decide(table, tasks)
            return self.control(table, before, targets, destinations)

    def control(
        self, table: ObjectTable, before: Tensor, targets: Tensor, destinations: Tensor
    ) -> Tensor:
        """Logits (B, 18) of the actions that bring targets (B,) to destinations (B, 2).

        If a block is left to move and the robot is still at its earlier pose `before` (B, 3), it is
        stuck and acts more randomly; so it does in an episode's first step, which has no other.
        """
        with torch.autocast(table.robot.device.type, enabled=False):
            inputs = control_inputs(table, targets, destinations)
        logits: Tensor = self.controller(*inputs).float()
        stuck = _stands(table.robot, before) & (targets != ROBOT_TARGET)
        return logits / torch.where(stuck, STUCK_TEMPERATURE, TEMPERATURE)[:, None]


def stacked_frames(observations: Tensor, number: int) -> Pixels:
    """Frame `number`, counted from the oldest, of stacks (B, 12, 96, 96): (B, 96, 96, 3)."""
    frames = observations[:, number * CHANNELS : (number + 1) * CHANNELS].permute(0, 2, 3, 1)
    return frames.cpu().numpy()


def _stands(robot: Tensor, before: Tensor) -> Tensor:
    """Whether each robot (B, 3) has hardly moved from its earlier pose (B, 3): (B,) bool."""
    moved = robot - before
    turned = torch.atan2(moved[:, 2].sin(), moved[:, 2].cos()).abs()
    return (moved[:, :2].abs().amax(dim=1) < STANDS) & (turned < STANDS_ANGLE)


def make_policy(config: ObjectBCConfig) -> ObjectPolicy:
    """The policy, initialised from the seed."""
    with seeded_init(config.seed):
        return ObjectPolicy(config)


def train(config: ObjectBCConfig, run: Run) -> None:
    """Learn from the demonstrations."""
    policy = make_policy(config)
    demonstrations = parse_demonstrations(load_demonstrations(config, run), policy.perception)
    ObjectBCTrainer(config, run, policy).fit(demonstrations)


class ObjectBCTrainer:
    """The goal model and the controller, each with its optimiser."""

    def __init__(
        self, config: ObjectBCConfig, run: Run, policy: ObjectPolicy, **others: Optimizer
    ) -> None:
        """Create a new trainer, or resume from the run's checkpoint, with further optimisers."""
        self.config, self.run, self.compute = config, run, run.compute
        self.device = self.compute.device
        self.policy = policy.to(self.device)
        self.goal_optimizer = torch.optim.Adam(
            self.policy.goals.parameters(), GOAL_LEARNING_RATE, fused=True
        )
        self.optimizer = torch.optim.AdamW(
            self.policy.controller.parameters(),
            config.learning_rate,
            weight_decay=WEIGHT_DECAY,
            fused=True,
        )
        kept = {"optimizer": self.optimizer, "goal_optimizer": self.goal_optimizer, **others}
        run.keep(policy=self.policy, **kept)

    def fit(self, demonstrations: Sequence[ParsedDemonstration]) -> None:
        """Train from the run's step to the last batch, or until the run stops."""
        data = ObjectData(demonstrations, self.config.tasks, self.device)
        seed = self.config.seed
        fit(self.run, lambda k: stream(seed, Purpose.BATCHES, k), partial(self.update, data))

    def update(self, data: ObjectData, number: int, rng: np.random.Generator) -> dict[str, Tensor]:
        """Take one step of each optimiser that is due; returns the metrics."""
        metrics = self.control_step(data, number, rng)
        if number % GOAL_EVERY == 0:
            metrics |= self.goal_step(data, number, rng)
        return metrics

    def control_step(
        self, data: ObjectData, number: int, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """Clone a batch of actions, given the goals found in hindsight."""
        config = self.config
        anneal(self.optimizer, number, config.batches)
        rows = data.sample_eventful(config.batch_size, rng)
        noise = rng.normal(0.0, DESTINATION_NOISE, (len(rows), 2)).astype(np.float32)
        destinations = data.destinations[rows] + torch.from_numpy(noise).to(self.device)
        mirrored = torch.from_numpy(rng.random(len(rows)) < 0.5).to(self.device)
        table, targets = data.table.select(rows), data.targets[rows]
        numbers = torch.arange(table.blocks.shape[1], device=self.device)
        dropped = torch.from_numpy(rng.random(table.colours.shape) < DROPPED)
        table = table.without(dropped.to(self.device) & (numbers != targets[:, None]))
        inputs = control_inputs(table, targets, destinations, mirrored)
        with self.compute.autocast():
            logits = self.policy.controller(*inputs).float()
        actions = data.actions[rows]
        exchanged = torch.tensor(MIRRORED_ACTIONS, device=self.device)
        actions = torch.where(mirrored, exchanged[actions], actions)
        loss = functional.cross_entropy(logits, actions)
        gradient_step(self.optimizer, loss)
        accuracy = (logits.argmax(dim=1) == actions).float().mean()
        return {"loss": loss, "accuracy": accuracy}

    def goal_step(
        self, data: ObjectData, number: int, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """Increase the likelihood of a batch of goals."""
        config, goals = self.config, self.policy.goals
        refit = number - config.batches // 2
        if 0 <= refit < GOAL_EVERY:  # first step of the second half
            goals.leave_out()
        anneal(self.goal_optimizer, number, config.batches)
        rows = data.sample_each(GOAL_BATCH_SIZE, rng)
        places = rng.uniform(-BORDER, BORDER, (len(rows), CANDIDATES, 2)).astype(np.float32)
        target_loss, destination_loss = goal_losses(
            goals,
            data.table.select(rows),
            data.relations[rows],
            data.targets[rows],
            data.destinations[rows],
            data.tasks[rows],
            torch.from_numpy(places).to(self.device),
        )
        penalty = goals.penalty(GOAL_SPARSITY * (REFITTED if refit >= 0 else 1.0))
        gradient_step(self.goal_optimizer, target_loss + destination_loss + penalty)
        return {"target_loss": target_loss, "destination_loss": destination_loss}


ALGORITHM = Algorithm(ObjectBCConfig, train, make_policy)
