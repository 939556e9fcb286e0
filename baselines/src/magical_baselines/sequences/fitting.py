"""Fitting a network to batches of demonstrations by supervised learning."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

from magical_baselines.augmentation.names import Augmentations, augment_option, parse_augmentations
from magical_baselines.config import Config, DemonstrationSettings, EncoderSettings
from magical_baselines.data.expert_data import ExpertData, load_demonstrations
from magical_baselines.data.prefetch import prefetch
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import restoring
from magical_baselines.running.devices import choose_device
from magical_baselines.running.optimizers import load_optimizer, optimizer_state, set_learning_rate
from magical_baselines.running.run import Run
from magical_baselines.settings import NOT_NEGATIVE, POSITIVE, Settings, option

MAX_GRAD_NORM = 10.0
QUICK = {"network": "narrow", "batches": 2400, "precision": "auto"}  # settings of the preset
AnyConfig = TypeVar("AnyConfig", bound="SequenceConfig")
Network = TypeVar("Network", bound=nn.Module)
Batch = TypeVar("Batch")


@dataclass(frozen=True, kw_only=True)
class FittingSettings(Settings):
    """How a network is fitted to demonstrations by AdamW."""

    batches: int = option(20_000, "training batches", POSITIVE)
    batch_size: int = option(32, "samples (for transformer-bc, windows) per batch", POSITIVE)
    learning_rate: float = option(
        5e-4, "AdamW's initial learning rate; annealed linearly to 0", POSITIVE
    )
    weight_decay: float = option(1e-4, "AdamW's weight decay", NOT_NEGATIVE)
    augment: str = augment_option("noise+translation+rotation")
    log_every: int = option(50, "batches between logged metrics", POSITIVE)

    @property
    def augmentations(self) -> Augmentations:
        """The augmentations of images."""
        return parse_augmentations(self.augment)


@dataclass(frozen=True, kw_only=True)
class SequenceConfig(Config):
    """Base of the configurations of sequence learners."""

    networks: EncoderSettings = field(default_factory=EncoderSettings)
    demonstrations: DemonstrationSettings
    fitting: FittingSettings = field(default_factory=FittingSettings)

    @property
    def num_updates(self) -> int:
        """The number of batches."""
        return self.fitting.batches

    @property
    def training_samples(self) -> int:
        """The samples of all batches."""
        return self.num_updates * self.fitting.batch_size


def _load_data(config: SequenceConfig, run: Run, device: str) -> ExpertData:
    demonstrations = load_demonstrations(config, run)
    return ExpertData(
        demonstrations, config.tasks, config.observation_spec, device=device, remove_noops=True
    )


def fit(
    config: AnyConfig,
    run: Run,
    network: Network,
    sample: Callable[[AnyConfig, ExpertData, int], Batch],
    losses: Callable[[Network, Batch], Mapping[str, Tensor]],
) -> None:
    """Train from the run's step to the last batch, or until the run stops.

    The data are the run's demonstrations, without no-ops as in behavioural cloning. Frames are
    augmented by rendering if all demonstrations have poses.

    Args:
        config: the configuration of the run.
        run: logs and saves the training, which continues from its checkpoint.
        network: the module to train, saved as the policy.
        sample: returns batch n, depending only on the configuration, the data and n.
        losses: the metrics of a batch, of which `loss` is minimised.

    Raises:
        DemonstrationsError, RunFolderError: see `load_demonstrations` and `ExpertData`.
    """
    fitting = config.fitting
    device = choose_device(config.device)
    data = _load_data(config, run, device)
    network.to(device).train()
    optimizer = AdamW(
        network.parameters(), fitting.learning_rate, weight_decay=fitting.weight_decay, fused=True
    )
    compute = run.compute(device, config.network_precision, config.threads)
    _restore(run, network, optimizer)
    averages, numbers = Averages(), range(run.step, fitting.batches)
    with prefetch(partial(sample, config, data), numbers, data.batches_on_host) as batches:
        for number, batch in zip(numbers, batches, strict=False):
            set_learning_rate(optimizer, fitting.learning_rate * (1.0 - number / fitting.batches))
            with compute.autocast():
                metrics = losses(network, batch)
            optimizer.zero_grad()
            torch.autograd.backward(metrics["loss"])
            nn.utils.clip_grad_norm_(network.parameters(), MAX_GRAD_NORM)
            optimizer.step()
            averages.add(fitting.batch_size, **metrics)
            if run.finish_step(
                number + 1,
                lambda: averages.reset(speed_of="loss"),
                lambda: {"policy": network.state_dict(), "optimizer": optimizer_state(optimizer)},
                log_every=fitting.log_every,
                last=number + 1 == fitting.batches,
            ):
                return


def _restore(run: Run, network: nn.Module, optimizer: Optimizer) -> None:
    """Continue from the run's checkpoint, if it has one."""
    if run.saved:
        with restoring(run.folder):
            network.load_state_dict(run.saved["policy"])
            load_optimizer(optimizer, run.saved["optimizer"])


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """The mean of values (...,) where a mask (...,) is true."""
    return (values * mask).sum() / mask.sum()
