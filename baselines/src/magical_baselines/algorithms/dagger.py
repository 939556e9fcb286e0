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

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from statistics import fmean
from typing import Any, ClassVar

import numpy as np

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.demos.record import provenance
from magical.envs import EnvId
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError
from magical.evaluation import environments
from magical.evaluation.policy import Policy
from magical.experts import EpisodeExpert, expert_for, get_planner, strategy_seed
from magical.runs.sources import EXPERT_LABELS, INTERACTION, TEST_VARIANTS
from magical.scene import Dynamics
from magical.tasks.axes import full_variant, short_variant
from magical_baselines.algorithms.bc import BCConfig, make_cloning, make_policy
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    Algorithm,
    Fraction,
    NonNegativeInt,
    PositiveInt,
    option,
)
from magical_baselines.data import load_demonstrations
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
        return self.rounds * self.batches

    @property
    def env_ids(self) -> list[EnvId]:
        """The environments of a round, one per episode; each task uses the variants that it has."""
        found = [environments([task], self.variants) for task in self.tasks]
        return [ids[i % len(ids)] for ids in found for i in range(self.episodes)]


def train(config: DAggerConfig, run: Run) -> None:
    """Alternate between collecting labelled episodes and behavioural cloning."""
    demonstrations = load_demonstrations(config, run)
    cloning = make_cloning(config, run)
    if run.step == config.num_updates:
        return
    writer, per_round = DatasetWriter(run.folder / AGGREGATE), len(config.env_ids)
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
            beta = float(config.beta_decay**number)
            # A run that was killed has left episodes of this round, which are the same again.
            stored = len(Dataset.open(writer.path))
            if stored < number * per_round:
                rng = stream(config.seed, Purpose.ENVIRONMENTS, number)
                policy = NetworkPolicy(cloning.network, config, run.compute)
                labelled = collect_labelled(envs, policy, beta, rng, round=number)
                for episode in labelled[stored % per_round :]:
                    writer.append(episode)
            aggregate = Dataset.open(writer.path)[: number * per_round]
            tasks = [entry.task for entry in aggregate.entries]
            learned = (*demonstrations, *zip(tasks, aggregate, strict=True))
            metrics = {
                "round": number,
                "expert_share": beta,
                "labels": sum(len(trajectory) for _, trajectory in learned),  # no-ops included
            }
            if number:
                metrics["score"] = fmean(e.final_score for e in aggregate.entries[-per_round:])
            if cloning.fit(learned, (number + 1) * config.batches, metrics):
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
    bodies, actions, wanted = [envs.bodies[0].copy()], [], []
    active = np.ones(count, np.bool_)
    while active.any():
        expert_actions = [
            expert.act(state) if is_active else 0
            for expert, state, is_active in zip(experts, envs.states(), active, strict=True)
        ]
        policy_actions = np.asarray(policy.act(observations, envs.env_ids, rng))
        is_experts = rng.random(count) < beta
        executed = np.where(is_experts, expert_actions, policy_actions)  # (N,)
        for expert, action in zip(experts, executed.tolist(), strict=True):
            expert.note_executed(action)
        observations, _, _, truncated, _ = envs.step(executed, active)
        active &= ~truncated
        bodies.append(envs.bodies[0].copy())
        actions.append(executed)
        wanted.append(expert_actions)
    taken, labels, tables = np.array(actions), np.array(wanted), np.stack(bodies)
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


ALGORITHM = Algorithm(DAggerConfig, train, make_policy)
