"""Reinforcement learning with PufferLib, then the benchmark's evaluation.

    pip install . ./goals ./baselines pufferlib-core

PPO is trained on MoveToRegion with state vectors and the dense reward, then evaluated on every
variant.
"""

import tempfile
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pufferlib.emulation
import pufferlib.models
import pufferlib.vector
import torch
from numpy.typing import NDArray
from pufferlib.pufferl import PuffeRL

from magical.evaluation import environments, evaluate, summarise

DEMO = "magical/MoveToRegion-Demo-v0"
NUM_ENVS = 16
NUM_STEPS = 80  # of each environment between updates: twice an episode's
CONFIG = {
    "bptt_horizon": NUM_STEPS,
    "batch_size": NUM_ENVS * NUM_STEPS,
    "minibatch_size": 320,
    "max_minibatch_size": 320,
    "update_epochs": 4,
    "learning_rate": 1e-3,
    "anneal_lr": True,
    "optimizer": "adam",
    "adam_beta1": 0.9,
    "adam_beta2": 0.999,
    "adam_eps": 1e-8,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "clip_coef": 0.2,
    "vf_coef": 0.5,
    "vf_clip_coef": 0.2,
    "ent_coef": 0.001,
    "max_grad_norm": 0.5,
    # Neither importance weights nor priorities: plain PPO.
    "vtrace_rho_clip": 1.0,
    "vtrace_c_clip": 1.0,
    "prio_alpha": 0.0,
    "prio_beta0": 1.0,
    "use_rnn": False,
    "seed": 0,
    "torch_deterministic": True,
    "cpu_offload": False,
    "device": "cpu",
    "precision": "float32",
    "compile": False,
    "compile_mode": "default",
    "compile_fullgraph": False,
    "checkpoint_interval": 1_000_000,  # none but the last
    "env": DEMO,
}


class PufferPolicy:
    """A network of PufferLib as a policy of the benchmark."""

    observation = "state"
    tasks = ("MoveToRegion",)

    def __init__(self, network: Any) -> None:
        self.network = network

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Do nothing: the policy keeps no state between steps."""

    def act(
        self, observations: NDArray[np.float32], env_ids: Sequence[str], rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """The most probable action for each state vector."""
        with torch.inference_mode():
            logits, _ = self.network(torch.from_numpy(observations))
        return np.asarray(logits.argmax(-1).numpy())


def make_env(buf: Any = None, seed: int = 0) -> Any:
    """The Demo variant as an environment of PufferLib, which writes into `buf`."""
    env = gymnasium.make(DEMO, observation="state", reward="dense")
    return pufferlib.emulation.GymnasiumPufferEnv(env, buf=buf, seed=seed)


def train(steps: int) -> PufferPolicy:
    """Train on the Demo variant only."""
    torch.manual_seed(0)
    envs = pufferlib.vector.make(make_env, backend=pufferlib.vector.Serial, num_envs=NUM_ENVS)
    network = pufferlib.models.Default(envs.driver_env)
    with tempfile.TemporaryDirectory() as folder:
        config = {**CONFIG, "total_timesteps": steps, "data_dir": folder}
        trainer = PuffeRL(config, envs, network)
        try:
            while trainer.global_step < steps:
                trainer.evaluate()
                trainer.train()
        finally:
            trainer.close()  # it has a thread that would keep the program from ending
    return PufferPolicy(network)


def main(steps: int = 51_200, rollouts: int = 100, workers: int | None = None) -> None:
    """Train, evaluate on all variants, print the scores."""
    policy = train(steps)
    scores = evaluate(policy, environments(policy.tasks), rollouts=rollouts, workers=workers)
    for variant, summary in summarise(scores).items():
        print(f"{variant:10} {summary['mean']:.2f}")


if __name__ == "__main__":
    main()
