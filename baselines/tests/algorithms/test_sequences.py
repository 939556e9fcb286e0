"""Supervised fitting: what is the same again, and what is left alone."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.tests.tiny_runs import tiny
from magical.envs import EnvId
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation.rollouts import play
from magical_baselines import find_algorithm, train
from magical_baselines.algorithms.chunks import masked_mean
from magical_baselines.policy import TrainedPolicy

ALGORITHMS = ("act", "diffusion", "transformer-bc")


class Recorded:
    """A policy, and the actions that it chose."""

    def __init__(self, policy: TrainedPolicy) -> None:
        self.policy, self.observation = policy, policy.observation
        self.actions: list[Any] = []

    def reset(self, mask: Any) -> None:
        self.policy.reset(mask)

    def act(self, observations: Any, env_ids: Any, rng: np.random.Generator) -> Any:
        self.actions.append(self.policy.act(observations, env_ids, rng).copy())
        return self.actions[-1]


def actions_of(policy: TrainedPolicy, seeds: list[int]) -> Any:
    """The actions (T, B) or (T, B, 3) of episodes that are rolled out together."""
    recorded = Recorded(policy)
    envs = MagicalVectorEnv(
        [EnvId("MoveToRegion", "TestAll")] * len(seeds),
        workers=0,
        observation=policy.observation,
        horizon=6,
        action_space=policy.action_space,
    )
    with closing(envs):
        for _ in play(recorded, envs, seeds):
            pass
    return np.array(recorded.actions)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_rollout_does_not_depend_on_the_others_of_its_batch(
    algorithm: str, demos: Path, tmp_path: Path
) -> None:
    config = tiny(find_algorithm(algorithm).config, demos=str(demos))
    policy = train(config, tmp_path / "run").policy()
    together = actions_of(policy, [3, 4, 5])
    for row, seed in enumerate([3, 4, 5]):
        np.testing.assert_allclose(together[:, row], actions_of(policy, [seed])[:, 0], atol=1e-4)
    assert not np.allclose(together[:, 0], together[:, 1])


def test_the_mean_is_of_what_is_not_masked() -> None:
    mask = torch.tensor([[True, True], [True, False]])
    assert masked_mean(torch.tensor([[1.0, 2.0], [6.0, 9.0]]), mask) == 3.0
