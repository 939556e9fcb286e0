"""Reinforcement learning with TorchRL, then the benchmark's evaluation.

    pip install . ./goals ./baselines "torchrl>=0.14"

PPO is trained on MoveToRegion with state vectors and the dense reward, then evaluated on every
variant.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper, SerialEnv
from torchrl.modules import MLP, OneHotCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from magical.evaluation import environments, evaluate, summarise

DEMO = "magical/MoveToRegion-Demo-v0"
NUM_ENVS = 16
NUM_STEPS = 80  # of each environment between updates: twice an episode's
EPOCHS = 4
MINIBATCH_SIZE = 320


class TorchRLPolicy:
    """A network of logits as a policy of the benchmark."""

    observation = "state"
    tasks = ("MoveToRegion",)

    def __init__(self, network: nn.Module) -> None:
        self.network = network

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Do nothing: the policy keeps no state between steps."""

    def act(
        self, observations: NDArray[np.float32], env_ids: Sequence[str], rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """The most probable action for each state vector."""
        with torch.inference_mode():
            logits = self.network(torch.from_numpy(observations))
        return np.asarray(logits.argmax(-1).numpy())


def make_env() -> Any:
    """The Demo variant as an environment of TorchRL."""
    return GymWrapper(gymnasium.make(DEMO, observation="state", reward="dense"))


def train(steps: int) -> TorchRLPolicy:
    """Train on the Demo variant only."""
    torch.manual_seed(0)
    envs = SerialEnv(NUM_ENVS, make_env)
    envs.set_seed(0)
    inputs, actions = envs.observation_spec["observation"].shape[-1], envs.action_spec.shape[-1]
    sizes = {"num_cells": [64, 64], "activation_class": nn.Tanh}
    network = MLP(inputs, actions, **sizes)
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["logits"]),
        in_keys=["logits"],
        distribution_class=OneHotCategorical,
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(inputs, 1, **sizes), in_keys=["observation"])
    loss_of = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.0, critic_coeff=0.5)
    advantages = GAE(gamma=0.99, lmbda=0.95, value_network=critic, average_gae=False)
    optimizer = torch.optim.Adam(loss_of.parameters(), lr=3e-4)
    collector = Collector(
        envs,
        actor,
        frames_per_batch=NUM_ENVS * NUM_STEPS,
        total_frames=steps,
        auto_register_policy_transforms=False,
    )
    for batch in collector:
        for _ in range(EPOCHS):
            with torch.no_grad():
                advantages(batch)
            samples = batch.reshape(-1)
            for rows in torch.randperm(len(samples)).split(MINIBATCH_SIZE):  # type: ignore[no-untyped-call]
                losses = loss_of(samples[rows])
                loss = sum(value for name, value in losses.items() if name.startswith("loss_"))
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(loss_of.parameters(), 0.5)
                optimizer.step()
    collector.shutdown()
    return TorchRLPolicy(network)


def main(steps: int = 51_200, rollouts: int = 100, workers: int | None = None) -> None:
    """Train, evaluate on all variants, print the scores."""
    policy = train(steps)
    scores = evaluate(policy, environments(policy.tasks), rollouts=rollouts, workers=workers)
    for variant, summary in summarise(scores).items():
        print(f"{variant:10} {summary['mean']:.2f}")


if __name__ == "__main__":
    main()
