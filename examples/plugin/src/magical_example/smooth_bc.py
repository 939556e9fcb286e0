"""Behavioural cloning with label smoothing: an algorithm in one file.

The loss is the cross-entropy with targets that give the demonstrator's action 1 - epsilon, and
share epsilon among all actions (Szegedy et al., 2016).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical_baselines.algorithms import Algorithm
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.config import Config, DemonstrationSettings, NetworkSettings
from magical_baselines.data.expert_data import ExpertData, load_demonstrations
from magical_baselines.models import PolicyNetwork, Trunk
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import StateDict, restoring
from magical_baselines.running.devices import choose_device
from magical_baselines.running.optimizers import load_optimizer, optimizer_state
from magical_baselines.running.run import Run
from magical_baselines.running.streams import Purpose, seeded_init, stream
from magical_baselines.settings import FRACTION, POSITIVE, option

LOG_EVERY = 50  # batches


@dataclass(frozen=True, kw_only=True)
class SmoothBCConfig(Config):
    """Settings of behavioural cloning with label smoothing."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {"network": "narrow", "batches": 1000},
    }

    algorithm: str = "smooth-bc"
    networks: NetworkSettings = field(default_factory=NetworkSettings)
    demonstrations: DemonstrationSettings
    smoothing: float = option(0.1, "epsilon: what all actions share", check=FRACTION)
    batches: int = option(5000, "training batches", check=POSITIVE)
    batch_size: int = option(32, "samples per batch", check=POSITIVE)
    learning_rate: float = option(1e-3, "Adam's learning rate", check=POSITIVE)

    @property
    def num_updates(self) -> int:
        """All batches."""
        return self.batches


def train(config: SmoothBCConfig, run: Run) -> None:
    """Train on batches of the demonstrations, from the run's newest checkpoint on."""
    compute = run.compute(choose_device(config.device), config.network_precision, config.threads)
    network = make_policy(config).to(compute.device)
    optimizer = torch.optim.Adam(network.parameters(), config.learning_rate)
    demonstrations = load_demonstrations(config, run)
    data = ExpertData(demonstrations, config.tasks, config.observation_spec, device=compute.device)
    if run.saved:
        with restoring(run.folder):
            network.load_state_dict(run.saved["policy"])
            load_optimizer(optimizer, run.saved["optimizer"])
    averages = Averages()
    network.train()
    for number in range(run.step, config.batches):
        rows = data.sample(config.batch_size, stream(config.seed, Purpose.BATCHES, number))
        actions, tasks = data.labels(rows)
        with compute.autocast():
            logits = network(to_unit(data.images(rows)), tasks)  # (B, 18)
        loss = smooth_loss(logits, actions, config.smoothing)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        averages.add(len(rows), loss=loss.detach())
        done = number + 1
        state = partial(state_dict, network, optimizer)
        if run.finish_step(
            done, averages.reset, state, log_every=LOG_EVERY, last=done == config.batches
        ):
            return


def smooth_loss(logits: Tensor, actions: Tensor, smoothing: float) -> Tensor:
    """Mean cross-entropy of logits (B, 18) and smoothed actions (B,): to be minimised."""
    return functional.cross_entropy(logits.float(), actions, label_smoothing=smoothing)


def state_dict(network: nn.Module, optimizer: torch.optim.Optimizer) -> StateDict:
    """What a checkpoint holds; `policy` is what is evaluated."""
    return {"policy": network.state_dict(), "optimizer": optimizer_state(optimizer)}


def make_policy(config: SmoothBCConfig) -> nn.Module:
    """The policy network, initialised from the seed."""
    with seeded_init(config.seed):
        trunk = Trunk(config.networks.network, config.input_shape, batch_norm=True)
        return PolicyNetwork(trunk, len(config.tasks))


ALGORITHM = Algorithm(SmoothBCConfig, train, make_policy)
