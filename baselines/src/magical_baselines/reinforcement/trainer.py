"""The base class of trainers whose policies act in environments."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any, Self

import numpy as np
from torch.optim import Adam

from magical.envs import EnvId
from magical.envs.env import Reward
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import RepeatedEvaluation
from magical_baselines.models import PolicyNetwork
from magical_baselines.policy import NetworkPolicy
from magical_baselines.reinforcement.interaction import InteractionConfig
from magical_baselines.reinforcement.monitoring import Metrics, Monitor
from magical_baselines.reinforcement.rollouts import RolloutEnvs
from magical_baselines.running.checkpoints import StateDict
from magical_baselines.running.devices import choose_device
from magical_baselines.running.optimizers import load_optimizer, optimizer_state
from magical_baselines.running.run import Run

SEED = 1  # of the evaluations; not the seed of reported results
ROLLOUTS = 20  # per task


class InteractionTrainer:
    """Trains a policy in environments, and evaluates it on its tasks' Demo variants.

    It is a context manager: on entry, the environments are opened, and started or resumed from the
    run's checkpoint. Evaluation environments are created for the first evaluation, then reused.
    """

    envs: RolloutEnvs
    _stack: ExitStack
    _evaluation: RepeatedEvaluation | None = None

    def __init__(
        self,
        config: InteractionConfig,
        run: Run,
        network: PolicyNetwork,
        learning_rate: float,
        reward: Reward = "none",
    ) -> None:
        """Create a trainer that optimises a network with Adam."""
        self.config, self.run = config, run
        self.previous_steps = config.num_updates - config.interaction.num_updates  # as pretraining
        self.device = choose_device(config.device)
        self.network = network.to(self.device)
        self.optimizer = Adam(self.network.parameters(), learning_rate, fused=True)
        self.compute = run.compute(self.device, config.network_precision, config.num_threads)
        self.monitor = Monitor()
        self._reward = reward

    def __enter__(self) -> Self:
        config = self.config
        with ExitStack() as stack:
            self.envs = stack.enter_context(RolloutEnvs(config, self.device, self._reward))
            self.start_or_resume()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def start_or_resume(self) -> None:
        """Reset the environments, or restore the state from the run's checkpoint."""
        raise NotImplementedError

    def state_dict(self) -> StateDict:
        """The state that the next update depends on; here optimiser, environments and monitor."""
        return {
            "optimizer": optimizer_state(self.optimizer),
            "envs": self.envs.state_dict(),
            "monitor": self.monitor.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` of this class returned."""
        load_optimizer(self.optimizer, state["optimizer"])
        self.envs.load_state_dict(state["envs"])
        self.monitor.load_state_dict(state["monitor"])

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
        """The mean score of the current weights; the network is in training mode afterwards."""
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
