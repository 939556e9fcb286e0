"""DAgger: the learner acts, the scripted expert says what it would have done, and again.

Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011. Round 0 is behavioural cloning of the demonstrations. In round i
the expert's action is taken with probability beta_i = decay^i at each step, else the learner's;
every state on the way gets the expert's label, and all that was labelled so far is learned from.

The run folder's `aggregate` is an ordinary dataset of what happened: actions are those that were
taken, the labels are in the metadata `expert_actions`. There is no published setting for these
tasks; `paper` has behavioural cloning's (Table 3), its 20,000 batches split between the rounds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any, ClassVar

import torch
from torch import Tensor

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.errors import InvalidConfigError, RunFolderError
from magical.evaluation import environments
from magical.evaluation.variants import full_variant, short_variant
from magical.experts import get_goals
from magical.learning.algorithms import Algorithm
from magical.learning.algorithms.bc import (
    Batch,
    BCConfig,
    Window,
    bc_step,
    choose_compute,
    make_optimizer,
    make_policy,
)
from magical.learning.augment import augment, parse_augmentations
from magical.learning.checkpoints import Tree, load_module, load_optimizer, optimizer_tree
from magical.learning.config import option
from magical.learning.devices import choose_device
from magical.learning.expert_data import Chosen, ExpertData, choose_demonstrations
from magical.learning.policy import NetworkPolicy
from magical.learning.prefetch import prepared
from magical.learning.runs import Run
from magical.learning.streams import Purpose, stream
from magical.learning.supervision import Supervision, relabelled

AGGREGATE = "aggregate"  # in the run folder


@dataclass(frozen=True, kw_only=True)
class DAggerConfig(BCConfig):
    """Settings of DAgger; the defaults are those of behavioural cloning (Table 3)."""

    algorithm: ClassVar[str] = "dagger"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {**BCConfig.presets["quick"], "rounds": 6, "batches": 400, "episodes": 5},
    }

    batches: int = option(2_000, "batches to learn from in each round")
    rounds: int = option(10, "rounds; in all but the first, the learner acts before it learns")
    episodes: int = option(10, "episodes of each task in such a round, variants taking turns")
    variants: tuple[str, ...] = option(("Demo",), "variants that the learner acts in")
    beta_decay: float = option(0.5, "round i takes the expert's actions with chance decay^i")
    restart: bool = option(False, "begin each round with fresh weights, not with the last ones")
    keep_noops: bool = option(False, "learn from no-op labels too")
    workers: int | None = option(None, "processes for the worlds (default: one a core)")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("rounds", "episodes")
        if not 0 <= self.beta_decay <= 1:
            raise InvalidConfigError(
                f"beta_decay: expected a number from 0 to 1, found {self.beta_decay}"
            )
        if (self.workers or 0) < 0:
            raise InvalidConfigError(f"workers: expected at least 0, found {self.workers}")
        names = (self.variants,) if isinstance(self.variants, str) else self.variants
        unique = dict.fromkeys(map(full_variant, names))
        object.__setattr__(self, "variants", tuple(map(short_variant, unique)))
        if not self.variants:
            raise InvalidConfigError("variants: expected at least one, found none")
        for task in self.tasks:
            get_goals(task)  # raises for a task without an expert
            env_ids = environments([task], self.variants)
            if self.episodes < len(env_ids):
                raise InvalidConfigError(
                    f"episodes: expected at least one for each of {len(env_ids)} variants of "
                    f"{task}, found {self.episodes}"
                )

    @property
    def total(self) -> int:
        """All rounds' batches."""
        return self.rounds * self.batches

    @property
    def env_ids(self) -> list[str]:
        """The worlds of a round, one an episode; tasks act in those of the variants they have."""
        found = [environments([task], self.variants) for task in self.tasks]
        return [ids[i % len(ids)] for ids in found for i in range(self.episodes)]

    def expert_share(self, number: int) -> float:
        """Beta of round `number`: 1 for the demonstrations, then falling geometrically."""
        return float(self.beta_decay**number)

    def step_size(self, number: int) -> float:
        """Of batch `number`: constant, or falling linearly to 0 while the same weights learn."""
        if not self.anneal:
            return self.learning_rate
        span = self.batches if self.restart else self.total
        return self.learning_rate * (1.0 - number % span / span)


def train(config: DAggerConfig, run: Run) -> None:
    """Learn, act and be corrected, in rounds."""
    chosen = choose_demonstrations(config.demos, config.tasks, config.num_demos, config.seed)
    run.describe(demonstrations=list(chosen.record))
    aggregate = Aggregate(config, run)
    learner = Learner(config, run)
    if run.step == config.total:
        return
    with Supervision(config.env_ids, config.observation, config.workers) as worlds:
        for number in range(run.step // config.batches, config.rounds):
            if aggregate.rounds < number:
                rng = stream(config.seed, Purpose.ENVIRONMENTS, number)
                share = config.expert_share(number)
                aggregate.extend(worlds.collect(learner.policy(), share, rng, round=number))
            if config.restart and run.step == number * config.batches:
                learner.begin()
            # Not kept here: the next round's data would be made while these are still in memory.
            if learner.learn(number, *aggregate.data(chosen, learner.device), aggregate.sums):
                break


class Aggregate:
    """The dataset of a run's own episodes, a whole number of rounds of them."""

    def __init__(self, config: DAggerConfig, run: Run) -> None:
        self._config = config
        self._per_round = len(config.env_ids)
        self.folder = run.folder / AGGREGATE
        self._writer = DatasetWriter(self.folder)
        self._dataset = Dataset.open(self.folder)
        # Of a round that was cut short while it was stored, the rest is stored again.
        sums = run.saved["aggregate"] if run.saved else []
        at_most = self._per_round * min(run.step // config.batches, config.rounds - 1)
        if self.sums[: len(sums)] != sums or len(self._dataset) > at_most:
            raise RunFolderError(
                f"{self.folder}: expected the {len(sums)} episodes that the checkpoint was "
                f"learned from, found {len(self._dataset)} or others; restore the folder from a "
                "copy, or begin another run"
            )

    @property
    def sums(self) -> list[str]:
        """The SHA-256 sums of all episodes."""
        return [entry.sha256 for entry in self._dataset.entries]

    @property
    def rounds(self) -> int:
        """How many rounds are stored wholly."""
        return len(self._dataset) // self._per_round

    def extend(self, episodes: Sequence[Trajectory]) -> None:
        """Store a round's episodes, but for those that are there already."""
        for episode in episodes[len(self._dataset) % self._per_round :]:
            self._writer.append(episode)
        self._dataset = Dataset.open(self.folder)

    def data(self, chosen: Chosen, device: str) -> tuple[ExpertData, dict[str, float]]:
        """All that was labelled, and what to report of it.

        `labels` counts what the expert was asked, the demonstrations' actions included; `samples`
        what of it is learned from; `score` is that of the last round's episodes.
        """
        config, entries = self._config, self._dataset.entries
        labelled = [(e.task, relabelled(t)) for e, t in zip(entries, self._dataset, strict=True)]
        everything = [*chosen.trajectories, *labelled]
        data = ExpertData(
            everything,
            config.tasks,
            config.pixels,
            device=device,
            remove_noops=not config.keep_noops,
        )
        labels = sum(len(trajectory) for _, trajectory in everything)
        facts: dict[str, float] = {"labels": labels, "samples": len(data)}
        if entries:
            facts["score"] = fmean(entry.final_score for entry in entries[-self._per_round :])
        return data, facts


class Learner:
    """The network and its optimiser, from round to round."""

    def __init__(self, config: DAggerConfig, run: Run) -> None:
        self.config = config
        self.run = run
        self.device = choose_device(config.device)
        self.begin()
        size = config.batch_size
        images = torch.zeros(size, *config.image_shape, device=self.device)
        numbers = torch.zeros(size, dtype=torch.int64, device=self.device)
        probe = Batch(images, numbers, numbers)
        self.compute = choose_compute(config, run, self.device, self.network, probe)
        if run.saved:
            load_module(self.network, run.saved["policy"], str(run.folder))
            load_optimizer(self.optimizer, run.saved["optimizer"])

    def begin(self) -> None:
        """Fresh weights and a fresh optimiser."""
        self.network = make_policy(self.config).to(self.device)
        self.optimizer = make_optimizer(self.config, self.network)
        self._forward = torch.compile(self.network) if self.config.compile else self.network

    def policy(self) -> NetworkPolicy:
        """What acts in the worlds: the present network."""
        config = self.config
        return NetworkPolicy(
            self.network, config.tasks, config.observation, config.form, self.compute
        )

    def learn(
        self, number: int, data: ExpertData, facts: dict[str, float], sums: list[str]
    ) -> bool:
        """Round `number`, or the rest of it, from episodes with these sums. Whether to stop."""
        config, run = self.config, self.run
        augmentations = parse_augmentations(config.augment)
        facts = {"round": number, "expert_share": config.expert_share(number), **facts}

        def collect(batch: int) -> Batch:
            rng = stream(config.seed, Purpose.BATCHES, batch)
            rows = data.sample(config.batch_size, rng)
            return Batch(augment(data.images(rows), augmentations, rng), *data.labels(rows))

        self.network.train()
        window = Window(self.device)
        last = (number + 1) * config.batches
        numbers = range(run.step, last)
        with prepared(collect, numbers, self.device) as batches:
            for done, batch in zip((n + 1 for n in numbers), batches, strict=False):
                loss, logits = self._step(batch, config.step_size(done - 1))
                window.add(loss, logits, batch.actions)
                stops = run.stops(done)
                if stops or done == last or done % config.log_every == 0:
                    metrics = window.report()
                    run.require_finite(done, metrics)
                    run.log(done, config.total, **facts, **metrics)
                if stops or done == last or done % config.checkpoint_every == 0:
                    run.checkpoint(done, {**self._tree(), "aggregate": sums})
                if stops:
                    return True
        return False

    def _step(self, batch: Batch, step_size: float) -> tuple[Tensor, Tensor]:
        """One step of the optimiser; returns the loss and the logits."""
        for group in self.optimizer.param_groups:
            group["lr"] = step_size
        return bc_step(self._forward, self.optimizer, self.compute, batch)

    def _tree(self) -> Tree:
        return {
            "policy": self.network.state_dict(),
            "optimizer": optimizer_tree(self.optimizer),
        }


ALGORITHM = Algorithm(DAggerConfig, train, make_policy)
