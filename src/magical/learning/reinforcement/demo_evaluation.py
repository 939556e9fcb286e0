"""Evaluations of a policy while it is trained."""

from typing import Self

import numpy as np

from magical.envs import EnvId
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import RepeatedEvaluation
from magical.learning.policy import NetworkPolicy
from magical.tasks import Horizon

SEED = 1  # not the seed of reported results
ROLLOUTS = 20  # of each task


class DemoEvaluation:
    """The score of a policy over its tasks' Demo variants, again and again during training.

    The environments are made for the first score and kept for the next ones.
    """

    def __init__(self, policy: NetworkPolicy, horizon: Horizon, workers: int | None) -> None:
        self._policy, self._workers = policy, workers
        self._how = Evaluation(
            env_ids=tuple(EnvId(task, "Demo") for task in policy.tasks),
            rollouts=ROLLOUTS,
            seed=SEED,
            horizon=horizon,
        )
        self._evaluation: RepeatedEvaluation | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._evaluation:
            self._evaluation.close()

    def score(self) -> float:
        """The mean score of the present weights; the network is in training mode afterwards."""
        self._evaluation = self._evaluation or RepeatedEvaluation(
            self._policy, self._how, self._workers
        )
        self._policy.network.eval()
        scores = self._evaluation.scores()
        self._policy.network.train()
        return float(np.mean([score.score for score in scores]))
