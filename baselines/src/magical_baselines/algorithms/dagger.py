"""DAgger: dataset aggregation, with the scripted experts as demonstrators.

Source: Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction to
no-regret online learning", AISTATS 2011. Round 0 is behavioural cloning of the demonstrations. Each
later round i

1. collects episodes in which each action is the expert's with probability beta_i = decay^i and
   otherwise the policy's; the expert labels every state;
2. adds them to the aggregated dataset;
3. continues behavioural cloning on everything labelled so far.

The run folder's `aggregate` is an ordinary dataset of the episodes, with the labels as their
`expert_actions`. There are no published settings for these tasks; `paper` has those of behavioural
cloning (Table 3), its 20,000 batches split between the rounds.
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from statistics import fmean
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.demos.record import provenance
from magical.envs import EnvId
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError, RunFolderError
from magical.evaluation import environments
from magical.evaluation.policy import Policy
from magical.experts import EpisodeExpert, expert_for, get_planner, strategy_seed
from magical.runs import EXPERT_LABELS, INTERACTION, TEST_VARIANTS
from magical.scene import Dynamics
from magical.tasks.axes import full_variant, short_variant
from magical_baselines.algorithms.bc import BCConfig, BCTrainer, make_policy
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    Algorithm,
    Fraction,
    NonNegativeInt,
    PositiveInt,
    option,
)
from magical_baselines.data import TaskTrajectories, load_demonstrations
from magical_baselines.policy import NetworkPolicy
from magical_baselines.training import Purpose, Run, stream

AGGREGATE = "aggregate"  # in the run folder


@dataclass(frozen=True, kw_only=True)
class DAggerConfig(BCConfig):
    """Settings of DAgger; the defaults are those of behavioural cloning (Table 3)."""

    observations: ClassVar[tuple[str, ...]] = IMAGE_OBSERVATIONS
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {**BCConfig.presets["quick"], "rounds": 6, "batches": 400, "episodes": 5},
    }

    algorithm: str = "dagger"
    batches: PositiveInt = option(2_000, "training batches of each round")
    rounds: PositiveInt = option(
        10, "rounds, each of `batches` batches; all but the first collect episodes"
    )
    episodes: PositiveInt = option(
        10, "episodes of each task per round, rotating through the variants"
    )
    variants: tuple[str, ...] = option(
        ("Demo",), "variants in which episodes are collected", metavar="VARIANT"
    )
    beta_decay: Fraction = option(
        0.5, "in round i, the expert's action is taken with probability decay^i"
    )
    workers: NonNegativeInt | None = option(None, "environment processes (default: one per core)")

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        tests = (TEST_VARIANTS,) if set(self.variants) - {"Demo"} else ()
        return (*super().learned_from, INTERACTION, EXPERT_LABELS, *tests)

    def __post_init__(self) -> None:
        super().__post_init__()
        unique = dict.fromkeys(map(full_variant, self.variants))
        object.__setattr__(self, "variants", tuple(map(short_variant, unique)))
        if not self.variants:
            raise InvalidConfigError("variants: expected at least one, found none")
        for task in self.tasks:
            get_planner(task)  # raises for a task without an expert
            env_ids = environments([task], self.variants)
            if self.episodes < len(env_ids):
                raise InvalidConfigError(
                    f"episodes: expected at least one for each of {len(env_ids)} variants of "
                    f"{task}, found {self.episodes}"
                )

    @property
    def num_updates(self) -> int:
        """The batches of all rounds."""
        return self.rounds * self.batches

    @property
    def env_ids(self) -> list[EnvId]:
        """The environments of a round, one per episode; each task uses the variants that it has."""
        found = [environments([task], self.variants) for task in self.tasks]
        return [ids[i % len(ids)] for ids in found for i in range(self.episodes)]

    def beta(self, number: int) -> float:
        """The probability of taking the expert's action in a round; 1 for the demonstrations."""
        return float(self.beta_decay**number)


def train(config: DAggerConfig, run: Run) -> None:
    """Alternate between collecting labelled episodes and behavioural cloning."""
    demonstrations = load_demonstrations(config, run)
    trainer = BCTrainer(config, run)
    aggregated = AggregatedDataset(config, run)
    run.keep(aggregate=aggregated)
    if run.step == config.num_updates:
        return
    with closing(
        MagicalVectorEnv(
            config.env_ids,
            workers=config.workers,
            observation=config.observation,
            autoreset_mode="Disabled",
            copy=False,
        )
    ) as envs:
        for number in range(run.step // config.batches, config.rounds):
            if aggregated.rounds < number:
                rng = stream(config.seed, Purpose.ENVIRONMENTS, number)
                policy = NetworkPolicy(trainer.network, config, trainer.compute)
                beta = config.beta(number)
                labelled = collect_labelled(envs, policy, beta, rng, round=number)
                aggregated.add_round(labelled)
            if train_round(config, number, trainer, demonstrations, aggregated):
                break


def collect_labelled(
    envs: MagicalVectorEnv, policy: Policy, beta: float, rng: np.random.Generator, **remarks: Any
) -> list[Trajectory]:
    """Collect one episode in each environment, labelled by its own expert.

    The expert follows the episode from the start; after a different action of the policy, it
    continues from the resulting state. At each step its action is taken with probability beta. The
    generator also determines the scenes, which are never scenes of evaluations. The remarks are
    added to the metadata.
    """
    count = envs.num_envs
    seeds = sample_training_seeds(rng, count)
    observations, _ = envs.reset(seed=seeds)
    policy.reset(np.ones(count, np.bool_))
    experts = [
        EpisodeExpert(expert_for(env_id.task, seed=strategy_seed(env_id.variant, seed)))
        for env_id, seed in zip(envs.env_ids, seeds, strict=True)
    ]
    taken, labels, tables = _act(envs, observations, policy, experts, beta, rng)
    metadata = {"expert_share": beta, **remarks, **provenance()}
    counts = envs.bodies[1].tolist()
    return [
        Trajectory.from_bodies(
            envs.env_ids[row],
            state.scene,
            taken[: state.horizon, row],
            tables[: state.horizon + 1, row, : counts[row]],
            dynamics=Dynamics.from_dict(envs.get_state(row)["dynamics"]),
            seed=seeds[row],
            demonstrator="dagger",
            expert_actions=labels[: state.horizon, row],
            metadata=metadata,
        )
        for row, state in enumerate(envs.states())
    ]


def _act(
    envs: MagicalVectorEnv,
    observations: Any,
    policy: Policy,
    experts: Sequence[EpisodeExpert],
    beta: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """The actions taken (T, N), the experts' (T, N), and bodies (T + 1, N, max bodies, 6)."""
    bodies, taken, labels = [envs.bodies[0].copy()], [], []
    active = np.ones(envs.num_envs, np.bool_)
    while active.any():
        expert_actions = [
            expert.act(state) if is_active else 0
            for expert, state, is_active in zip(experts, envs.states(), active, strict=True)
        ]
        policy_actions = np.asarray(policy.act(observations, envs.env_ids, rng))
        is_experts = rng.random(envs.num_envs) < beta
        actions = np.where(is_experts, expert_actions, policy_actions)  # (N,)
        for expert, action in zip(experts, actions.tolist(), strict=True):
            expert.note_executed(action)
        observations, _, _, truncated, _ = envs.step(actions, active)
        active &= ~truncated
        bodies.append(envs.bodies[0].copy())
        taken.append(actions)
        labels.append(expert_actions)
    return np.array(taken), np.array(labels), np.stack(bodies)


def train_round(
    config: DAggerConfig,
    number: int,
    trainer: BCTrainer,
    demonstrations: TaskTrajectories,
    aggregated: "AggregatedDataset",
) -> bool:
    """Train on everything labelled so far; true if the run stops in this round."""
    episodes = aggregated.until(number)
    entries = episodes.entries
    labelled = (*demonstrations, *zip((entry.task for entry in entries), episodes, strict=True))
    metrics = {
        "round": number,
        "expert_share": config.beta(number),
        "labels": sum(len(trajectory) for _, trajectory in labelled),  # before removing no-ops
    }
    if number:
        metrics["score"] = fmean(e.final_score for e in entries[-len(config.env_ids) :])
    return trainer.fit(labelled, (number + 1) * config.batches, metrics)


class AggregatedDataset:
    """The labelled episodes of a run on disk, in the order of their rounds."""

    def __init__(self, config: DAggerConfig, run: Run) -> None:
        """Create or open the dataset."""
        self._per_round = len(config.env_ids)
        # There may be one more round, complete or partial, if the run ended while collecting it.
        self._at_most = self._per_round * min(run.step // config.batches + 1, config.rounds - 1)
        self.folder = run.folder / AGGREGATE
        self._writer = DatasetWriter(self.folder)
        self._dataset = Dataset.open(self.folder)
        self._used = 0  # episodes that the policy has learned from
        if not run.saved:
            self.load_state_dict({"sha256": []})

    def state_dict(self) -> dict[str, Any]:
        """The digests of the episodes that the policy has learned from."""
        return {"sha256": [entry.fingerprint for entry in self._dataset.entries[: self._used]]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Check that the folder has the episodes of a checkpoint.

        Raises:
            RunFolderError: the episodes are not those that the checkpoint was trained on.
        """
        expected = list(state["sha256"])
        found = [entry.fingerprint for entry in self._dataset.entries]
        if found[: len(expected)] != expected or len(found) > self._at_most:
            raise RunFolderError(
                f"{self.folder}: expected the {len(expected)} episodes that the checkpoint was "
                f"learned from, found {len(found)} or others; restore the folder from a "
                "copy, or begin another run"
            )
        self._used = len(expected)

    @property
    def rounds(self) -> int:
        """The number of complete rounds."""
        return len(self._dataset) // self._per_round

    def add_round(self, episodes: Sequence[Trajectory]) -> None:
        """Store the episodes of a round, except those already stored before an interruption."""
        for episode in episodes[len(self._dataset) % self._per_round :]:
            self._writer.append(episode)
        self._dataset = Dataset.open(self.folder)

    def until(self, number: int) -> Dataset:
        """The episodes of rounds 1 to `number`, to learn from; later ones may be stored, too."""
        self._used = number * self._per_round
        return self._dataset[: self._used]


ALGORITHM = Algorithm(DAggerConfig, train, make_policy)
