"""Behavioural cloning: the demonstrator's action as a label (appendix B, Table 3)."""

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import SGD, Adam, Optimizer

from magical.learning.algorithms import Algorithm
from magical.learning.augment import augment, parse_augmentations
from magical.learning.checkpoints import load_module, load_optimizer, optimizer_tree
from magical.learning.config import ImitationConfig, option
from magical.learning.devices import Compute, choose_device
from magical.learning.expert_data import ExpertData, choose_demonstrations
from magical.learning.networks import PolicyNetwork, Trunk, get_width
from magical.learning.prefetch import prepared
from magical.learning.runs import Run
from magical.learning.streams import Purpose, seeded_weights, stream


@dataclass(frozen=True, kw_only=True)
class BCConfig(ImitationConfig):
    """Settings of behavioural cloning; the defaults are Table 3's."""

    algorithm: ClassVar[str] = "bc"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            "network": "small",
            "batches": 2400,
            "optimizer": "adam",
            "learning_rate": 1e-3,
            "momentum": 0.9,
            "anneal": True,
            "augment": "noise+translation+rotation",
        },
    }

    batches: int = option(20_000, "batches to learn from in all")
    batch_size: int = option(32, "samples in a batch")
    optimizer: str = option("sgd", "optimiser: sgd or adam")
    learning_rate: float = option(1e-3, "step size at the start")
    momentum: float = option(0.1, "momentum; for adam, of the mean gradient (beta 1)")
    anneal: bool = option(False, "let the step size fall linearly to 0")
    augment: str = option("all", "all, none, no-trans-rot, or names joined by +")
    log_every: int = option(50, "batches between reports")
    checkpoint_every: int = option(500, "batches between checkpoints")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_one_of("optimizer", ("sgd", "adam"))
        self.require_positive("batches", "batch_size", "learning_rate")
        self.require_positive("log_every", "checkpoint_every")
        self.require_augmentations("augment")

    @property
    def total(self) -> int:
        """All batches."""
        return self.batches


def train(config: BCConfig, run: Run) -> None:
    """Learn from demonstrations, batch by batch."""
    device = choose_device(config.device)
    data = load_demonstrations(config, run, device)
    augmentations = parse_augmentations(config.augment)

    def collect(number: int) -> Batch:
        rng = stream(config.seed, Purpose.BATCHES, number)
        rows = data.sample(config.batch_size, rng)
        return Batch(augment(data.images(rows), augmentations, rng), *data.labels(rows))

    network = make_policy(config).to(device)
    optimizer = make_optimizer(config, network)
    compute = choose_compute(config, run, device, network, collect(run.step))
    if run.saved:
        load_module(network, run.saved["policy"], str(run.folder))
        load_optimizer(optimizer, run.saved["optimizer"])
    forward = torch.compile(network) if config.compile else network

    window = Window(device)
    numbers = range(run.step, config.batches)
    with prepared(collect, numbers, device) as batches:
        for number, batch in zip(numbers, batches, strict=False):
            set_step_size(optimizer, config, number)
            loss, logits = bc_step(forward, optimizer, compute, batch)
            window.add(loss, logits, batch.actions)
            done = number + 1
            ends = done == config.batches or run.stops(done)
            if ends or done % config.log_every == 0:
                metrics = window.report()
                run.require_finite(done, metrics)
                run.log(done, config.batches, **metrics)
            if ends or done % config.checkpoint_every == 0:
                tree = {"policy": network.state_dict(), "optimizer": optimizer_tree(optimizer)}
                run.checkpoint(done, tree)
            if ends:
                break


class Batch(NamedTuple):
    """What one update learns from."""

    images: Tensor  # (B, C, H, W) float32 in [0, 1]
    actions: Tensor  # (B,) int64
    tasks: Tensor  # (B,) int64


def bc_loss(logits: Tensor, actions: Tensor) -> Tensor:
    """Mean negative log-likelihood of actions (B,) under logits (B, 18): to be minimised."""
    return functional.cross_entropy(logits.float(), actions)


def bc_step(
    forward: Callable[[Tensor, Tensor], Tensor],
    optimizer: Optimizer,
    compute: Compute,
    batch: Batch,
) -> tuple[Tensor, Tensor]:
    """One step of the optimiser on a batch; returns the loss and the logits (B, 18)."""
    with compute.autocast():
        logits = forward(batch.images, batch.tasks)
    loss = bc_loss(logits, batch.actions)
    optimizer.zero_grad()
    torch.autograd.backward(loss)
    optimizer.step()
    return loss, logits


def make_policy(config: BCConfig) -> PolicyNetwork:
    """The network, with first weights from the seed; policies of BC have batch norm."""
    with seeded_weights(config.seed):
        trunk = Trunk(get_width(config.network), config.input_shape, batch_norm=True)
        return PolicyNetwork(trunk, len(config.tasks))


def make_optimizer(config: BCConfig, network: nn.Module) -> Optimizer:
    """The optimiser; its momentum is Adam's beta 1."""
    rate, momentum = config.learning_rate, config.momentum
    if config.optimizer == "sgd":
        return SGD(network.parameters(), rate, momentum, fused=True)
    return Adam(network.parameters(), rate, (momentum, 0.999), fused=True)


def set_step_size(optimizer: Optimizer, config: BCConfig, number: int) -> None:
    """The step size of batch `number`: constant, or falling linearly to 0."""
    left = 1.0 - number / config.batches if config.anneal else 1.0
    for group in optimizer.param_groups:
        group["lr"] = config.learning_rate * left


def load_demonstrations(config: BCConfig, run: Run, device: str) -> ExpertData:
    """The run's demonstrations without their no-ops, noted in its record."""
    chosen = choose_demonstrations(config.demos, config.tasks, config.num_demos, config.seed)
    run.describe(demonstrations=list(chosen.record))
    return ExpertData(
        chosen.trajectories, config.tasks, config.observation_spec, device=device, remove_noops=True
    )


def choose_compute(
    config: BCConfig, run: Run, device: str, network: nn.Module, batch: Batch
) -> Compute:
    """Device and precision: the faster one for this network and batch, tried on a copy."""
    probe = copy.deepcopy(network)
    return run.compute(
        device, config.precision, lambda: bc_loss(probe(batch.images, batch.tasks), batch.actions)
    )


class Window:
    """Loss, accuracy and speed since the last report; summed on the device, read once a report."""

    def __init__(self, device: str) -> None:
        self._sums = torch.zeros(2, device=device)
        self._start()

    def add(self, loss: Tensor, logits: Tensor, actions: Tensor) -> None:
        """Count a batch."""
        hits = (logits.detach().argmax(dim=1) == actions).sum()
        self._sums += torch.stack([loss.detach() * len(actions), hits])
        self._samples += len(actions)

    def report(self) -> dict[str, float]:
        """The means since the last report, which begins anew."""
        loss, accuracy = (self._sums / self._samples).tolist()
        speed = self._samples / (time.perf_counter() - self._began)
        self._start()
        return {"loss": loss, "accuracy": accuracy, "samples_per_second": speed}

    def _start(self) -> None:
        self._sums.zero_()
        self._samples = 0
        self._began = time.perf_counter()


ALGORITHM = Algorithm(BCConfig, train, make_policy)
