"""What the trainers of policies that act in environments have in common."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Self

import numpy as np

from magical.envs import EnvId
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import RepeatedEvaluation
from magical.learning.models import PolicyNetwork
from magical.learning.policy import NetworkPolicy
from magical.learning.reinforcement.interaction import InteractionConfig
from magical.learning.reinforcement.monitoring import Metrics, Monitor
from magical.learning.reinforcement.rollouts import RolloutEnvs
from magical.learning.running.checkpoints import StateDict
from magical.learning.running.devices import Compute
from magical.learning.running.run import Run

SEED = 1  # of the evaluations; not the seed of reported results
ROLLOUTS = 20  # of each task


class InteractionTrainer:
    """A policy that is trained in environments, and evaluated over its tasks' Demo variants.

    A subclass sets the attributes, and lets `_stack` close what it opens. The environments of
    evaluations are made for the first one and kept for the next ones.
    """

    config: InteractionConfig
    run: Run
    network: PolicyNetwork
    compute: Compute
    envs: RolloutEnvs
    monitor: Monitor
    previous_steps = 0  # that the run takes before the first update, such as pretraining
    _stack: ExitStack
    _evaluation: RepeatedEvaluation | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def state_dict(self) -> StateDict:
        """Everything that the next update depends on."""
        raise NotImplementedError

    def finish_update(
        self, update: int, metrics: Metrics, extra_state: Callable[[], StateDict] = dict
    ) -> bool:
        """Evaluate, log and save checkpoints (with the extra state); true if the run stops."""
        settings, done = self.config.interaction, update + 1
        metrics |= self.monitor.metrics()
        every, last = settings.evaluate_every, done == settings.num_updates
        if every and (done % every == 0 or last):
            metrics["evaluation_score"] = self._evaluate()
        steps: Metrics = {"environment_steps": done * settings.steps_per_update}
        return self.run.finish_step(
            self.previous_steps + done,
            lambda: {**self.monitor.warning(metrics), **steps, **metrics},
            lambda: {**self.state_dict(), **extra_state()},
            last=last,
        )

    def _evaluate(self) -> float:
        """The mean score of the present weights; the network is in training mode afterwards."""
        if not self._evaluation:
            settings = self.config.interaction
            policy = NetworkPolicy(self.network, self.config, self.compute)
            env_ids = tuple(EnvId(task, "Demo") for task in self.config.tasks)
            how = Evaluation(
                env_ids=env_ids, rollouts=ROLLOUTS, seed=SEED, horizon=settings.env_horizon
            )
            self._evaluation = RepeatedEvaluation(policy, how, settings.workers)
            self._stack.callback(self._evaluation.close)
        self.network.eval()
        scores = self._evaluation.scores()
        self.network.train()
        return float(np.mean([score.score for score in scores]))
