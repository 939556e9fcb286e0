"""Apprenticeship learning by matching feature expectations (appendix B). Single-task only.

First an autoencoder is trained on the expert's samples; its encoder phi is then frozen. Each update

1. collects a rollout with the current policy (the novice) and adds it to a replay buffer;
2. computes in closed form the weights w that best separate the mean features of expert and novice;
3. updates the policy by PPO with the normalised reward w^T phi(s, a).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.optim import Adam

from magical.errors import InvalidConfigError
from magical_baselines.algorithms import Algorithm
from magical_baselines.algorithms.ppo import (
    PUBLISHED_CODE,
    QUICK,
    PPOTrainer,
    ReinforcementConfig,
    make_policy,
)
from magical_baselines.augmentation.augment import augment, to_unit
from magical_baselines.augmentation.names import SETS, Augmentations, augment_option
from magical_baselines.autoencoder import SIZE, Autoencoder, autoencoder_loss, save_reconstructions
from magical_baselines.config import APPENDIX, DemonstrationSettings
from magical_baselines.data.expert_data import ExpertData, Rows, load_demonstrations
from magical_baselines.models import new_statistics
from magical_baselines.reinforcement.replay_buffer import ROLLOUTS, ReplayBuffer
from magical_baselines.reinforcement.reward_normalisation import RewardNormaliser, reward_floor
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import StateDict, restoring
from magical_baselines.running.devices import Compute
from magical_baselines.running.optimizers import load_optimizer, optimizer_state, set_learning_rate
from magical_baselines.running.run import Run
from magical_baselines.running.streams import Purpose, seeded_init, stream
from magical_baselines.settings import POSITIVE, option

AUTOENCODER_INIT = 1  # number of the initialisation; the policy's is 0
WEIGHT_NORM = 2.0  # of w (appendix B, equation 1)
SMALLEST_ERROR = 1e-6  # least error of the mean image; if all images are equal it is 0
RIDGE = 1e-3  # share of the mean feature variance that `discriminant_weights` adds to each variance
LOG_EVERY = 50  # batches of pretraining
NUM_RECONSTRUCTIONS = 10  # frames in the picture
PICTURE = "reconstructions.png"
PASSED = 12  # samples each of expert and novice that the published code encodes in training mode
STATISTICS_BATCHES = 60
REFINED = "refined"
CHUNK = 64  # samples per forward pass without gradients or batch statistics


@dataclass(frozen=True, kw_only=True)
class ALConfig(ReinforcementConfig):
    """Settings of apprenticeship learning; the defaults are appendix B's and Table 4's."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            **QUICK,
            "total_steps": 45_000,
            "gamma": 0.95,
            "ent_coef": 3e-3,
            "pretraining_batches": 200,
            "pretraining_learning_rate": 1e-3,
            "autoencoder": REFINED,
            "weight_metric": "covariance",
        },
        "published-code": {
            **PUBLISHED_CODE,
            "pretraining_batch_size": 12,
            "augment": "all",
            "feature_samples": 264,
        },
    }

    algorithm: str = "al"
    demonstrations: DemonstrationSettings
    pretraining_batches: int = option(8192, "batches of pretraining the autoencoder", POSITIVE)
    pretraining_batch_size: int = option(24, "expert samples per pretraining batch", POSITIVE)
    pretraining_learning_rate: float = option(
        3e-4, "Adam's learning rate for the autoencoder", POSITIVE
    )
    augment: str = augment_option(
        "none", "the autoencoder's images; of w's instead by the published code's conventions"
    )
    autoencoder: str = option(
        APPENDIX,
        "refined: its learning rate is annealed linearly to 0; it decodes the difference from the "
        "expert's mean image, with an error relative to that image's; no ReLU follows its "
        f"features; batch norm statistics are of {STATISTICS_BATCHES} unaugmented batches after "
        "pretraining",
        choices=(APPENDIX, REFINED),
    )
    feature_samples: int = option(
        512, "samples of the expert, and as many of the novice, to compute w from", POSITIVE
    )
    weight_metric: str = option(
        "euclidean",
        "which norm of w is bounded: |w|, or the standard deviation of w^T phi over the samples",
        choices=("euclidean", "covariance"),
    )
    reward_std: float = option(0.1, "standard deviation of the normalised rewards", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_one_task()
        if self.feature_samples < 2 and self.weight_metric == "covariance":
            raise InvalidConfigError(
                "feature_samples: expected at least 2 for a covariance, found 1"
            )
        if self.input_shape[1:] != (SIZE, SIZE):
            raise InvalidConfigError(
                f"observation: expected images of {SIZE} pixels, found {self.input_shape[1:]}"
            )

    @property
    def refined(self) -> bool:
        """Whether the autoencoder is the refined one."""
        return self.autoencoder == REFINED

    @property
    def augmentations(self) -> Augmentations:
        """The augmentations of the autoencoder's images, or of w's (`PUBLISHED`)."""
        return self.networks.augmentations(self.augment)

    @property
    def num_updates(self) -> int:
        """The number of pretraining batches and policy updates."""
        return self.pretraining_batches + self.ppo.num_updates

    @property
    def training_samples(self) -> int:
        """The samples of the autoencoder, twice because of the decoder, and of the policy."""
        pretraining = self.pretraining_batches * self.pretraining_batch_size
        return 2 * pretraining + super().training_samples


def train(config: ALConfig, run: Run) -> None:
    """Pretrain the autoencoder, then imitate demonstrations."""
    demonstrations = load_demonstrations(config, run)
    with PPOTrainer(config, run) as ppo:
        expert = ExpertData(
            demonstrations, config.tasks, config.observation_spec, device=ppo.device
        )
        autoencoder = make_autoencoder(config).to(ppo.device)
        if not pretrain(config, run, ppo, expert, autoencoder):
            return
        is_imitating = "apprentice" in (run.saved or {})
        if not is_imitating:  # which may have changed the encoder's batch norm
            save_expert_reconstructions(run, ppo, expert, autoencoder)
        imitate(config, run, ppo, expert, autoencoder)


def pretrain(
    config: ALConfig, run: Run, ppo: PPOTrainer, expert: ExpertData, autoencoder: Autoencoder
) -> bool:
    """Train the autoencoder on the expert's samples, then freeze it.

    Returns:
        Whether the pretraining is complete; if not, the run stops.
    """
    optimizer = Adam(autoencoder.parameters(), config.pretraining_learning_rate, fused=True)
    if run.saved:
        with restoring(run.folder):
            autoencoder.load_state_dict(run.saved["autoencoder"])
            if "autoencoder_optimizer" in run.saved:
                load_optimizer(optimizer, run.saved["autoencoder_optimizer"])
    scale = autoencoder.scale**2  # the error is of pixels in the encoder's range
    if config.refined:
        autoencoder.mean_image, scale = mean_image(expert)

    def state_dict() -> StateDict:
        return {
            "policy": ppo.network.state_dict(),
            "autoencoder": autoencoder.state_dict(),
            "autoencoder_optimizer": optimizer_state(optimizer),
        }

    averages = Averages()
    for number in range(run.step, config.pretraining_batches):
        losses = pretraining_step(
            config, ppo.compute, expert, autoencoder, optimizer, number, scale
        )
        done = number + 1
        last = done == config.pretraining_batches
        if last and config.refined:
            compute_statistics(config, ppo.compute, expert, autoencoder)
        averages.add(1, **losses)
        if run.finish_step(done, averages.reset, state_dict, log_every=LOG_EVERY, last=last):
            return False
    autoencoder.eval().requires_grad_(False)
    return True


def pretraining_step(
    config: ALConfig,
    compute: Compute,
    expert: ExpertData,
    autoencoder: Autoencoder,
    optimizer: Adam,
    number: int,
    scale: float = 1.0,
) -> dict[str, Tensor]:
    """Take an optimiser step on batch `number`; returns the parts of the loss, unscaled.

    The loss is the image error, divided by `scale`, plus the action loss.
    """
    left = 1.0 - number / config.pretraining_batches if config.refined else 1.0
    set_learning_rate(optimizer, config.pretraining_learning_rate * left)
    rng = stream(config.seed, Purpose.PRETRAINING, number)
    rows = expert.sample_counts([config.pretraining_batch_size], rng)
    augmentations = SETS["none"] if config.networks.published else config.augmentations
    images = augment(expert.images(rows), augmentations, rng)
    actions, _ = expert.labels(rows)
    with compute.autocast():
        reconstructed, logits = autoencoder(images, actions)
    image_error, action_loss = autoencoder_loss(images, actions, reconstructed, logits)
    optimizer.zero_grad()
    torch.autograd.backward(image_error / scale + action_loss)
    optimizer.step()
    return {"image_error": image_error, "action_loss": action_loss}


def mean_image(expert: ExpertData) -> tuple[Tensor, float]:
    """The mean (C, H, W) of the expert's images, and its mean squared error, at least 1e-6."""
    chunks = np.array_split(np.arange(len(expert)), -(-len(expert) // CHUNK))
    total = sum(to_unit(expert.images(rows)).sum(dim=0) for rows in chunks)
    mean = torch.as_tensor(total / len(expert))
    errors = [(to_unit(expert.images(rows)) - mean).square().mean().item() for rows in chunks]
    return mean, max(float(np.average(errors, weights=list(map(len, chunks)))), SMALLEST_ERROR)


def compute_statistics(
    config: ALConfig, compute: Compute, expert: ExpertData, autoencoder: Autoencoder
) -> None:
    """Replace batch norm's running statistics with means over unaugmented expert batches."""
    rng = stream(config.seed, Purpose.PRETRAINING, config.pretraining_batches)
    with new_statistics(autoencoder), compute.autocast():
        for _ in range(STATISTICS_BATCHES):
            rows = expert.sample_counts([config.pretraining_batch_size], rng)
            autoencoder(unaugmented(expert, rows), expert.labels(rows)[0])


def imitate(
    config: ALConfig, run: Run, ppo: PPOTrainer, expert: ExpertData, autoencoder: Autoencoder
) -> None:
    """Alternate between computing w and updating the policy."""
    replay_buffer = ReplayBuffer(ROLLOUTS, ppo.envs.task_of)
    normaliser = RewardNormaliser(1, config.reward_std, reward_floor(config.networks))
    normaliser.to(ppo.device)
    if run.saved and "apprentice" in run.saved:
        saved = run.saved["apprentice"]
        with restoring(run.folder):
            replay_buffer.load_state_dict(saved["replay_buffer"], ppo.device)
            normaliser.load_state_dict(saved["reward_statistics"])

    def encode(images: Tensor, actions: Tensor) -> Tensor:
        with torch.no_grad(), ppo.compute.autocast():
            features: Tensor = autoencoder.encoder(images, actions)
        return features.float()

    def state_dict() -> StateDict:
        apprentice = {
            "replay_buffer": replay_buffer.state_dict(),
            "reward_statistics": normaliser.state_dict(),
        }
        return {"autoencoder": autoencoder.state_dict(), "apprentice": apprentice}

    for update in ppo.remaining_updates():
        rollout = ppo.collect_rollout(update)
        with ppo.monitor.timed("features"):
            replay_buffer.add(rollout.observations, rollout.actions)
            rng = stream(config.seed, Purpose.DISCRIMINATOR, update)
            batch = sample_batch(config, expert, replay_buffer, rng)
            chunks = zip(*(torch.split(part, CHUNK) for part in batch), strict=True)
            features = torch.cat([encode(images, actions) for images, actions in chunks])
            if config.networks.published:  # batch norm's statistics adapt to the novice's images
                autoencoder.train()
                encode(*(torch.cat([p[:PASSED] for p in part.chunk(2)]) for part in batch))
                autoencoder.eval()
            w, distance = WEIGHTS[config.weight_metric](*features.chunk(2))
            pairs = zip(rollout.observations, rollout.actions, strict=True)
            raw = torch.stack([encode(to_unit(o), a) @ w for o, a in pairs])  # (T, N)
            rewards = normaliser(raw, rollout.tasks)
        metrics = ppo.improve_policy(update, rollout, rewards)
        metrics |= {
            "raw_reward": raw.mean().item(),
            "raw_reward_std": raw.std(correction=0).item(),
            "feature_distance": distance.item(),
        }
        if ppo.finish_update(update, metrics, state_dict):
            break


def sample_batch(
    config: ALConfig, expert: ExpertData, replay_buffer: ReplayBuffer, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Images and actions to compute w from: the expert's, then as many of the novice's."""
    rows = expert.sample_counts([config.feature_samples], rng)
    novice_images, novice_actions, _ = replay_buffer.sample([config.feature_samples], rng)
    images = torch.cat([expert.images(rows), novice_images])
    augmentations = config.augmentations if config.networks.published else SETS["none"]
    return augment(images, augmentations, rng), torch.cat([expert.labels(rows)[0], novice_actions])


def feature_weights(expert: Tensor, novice: Tensor) -> tuple[Tensor, Tensor]:
    """Maximise w^T (mean expert - mean novice) over |w|_2 <= 2, for features (B, 32) of each.

    By Cauchy-Schwarz, w is parallel to the difference of the means; it is 0 if the means are equal.

    Returns:
        w (32,) and the maximum, a scalar.
    """
    difference = expert.mean(dim=0) - novice.mean(dim=0)
    length = difference.norm()
    w = WEIGHT_NORM * difference / length.clamp(min=torch.finfo(length.dtype).tiny)
    return w, WEIGHT_NORM * length


def discriminant_weights(expert: Tensor, novice: Tensor) -> tuple[Tensor, Tensor]:
    """Maximise w^T (mean expert - mean novice) over w^T C w <= 4, for features (B, 32) of each.

    C is the mean of the two covariance matrices, so w is Fisher's linear discriminant. Unlike with
    |w|_2 <= 2, features with a large spread do not mask the others: except for a small multiple of
    the identity that is added to C, w^T phi is invariant to invertible linear maps of the features.

    Returns:
        w (32,) and the maximum, a scalar.
    """
    difference = (expert.mean(dim=0) - novice.mean(dim=0)).double()
    covariance = (torch.cov(expert.T.double()) + torch.cov(novice.T.double())) / 2
    identity = torch.eye(len(covariance), dtype=torch.float64, device=covariance.device)
    smallest = torch.finfo(torch.float64).tiny  # for features that are all equal
    ridge = RIDGE * covariance.diagonal().mean() + smallest
    direction = torch.linalg.solve(covariance + ridge * identity, difference)
    length = (difference @ direction).clamp(min=0.0).sqrt()  # Mahalanobis distance of the means
    w = WEIGHT_NORM * direction / length.clamp(min=smallest)
    return w.to(expert.dtype), (WEIGHT_NORM * length).to(expert.dtype)


WEIGHTS = {"euclidean": feature_weights, "covariance": discriminant_weights}


def unaugmented(expert: ExpertData, rows: Rows) -> Tensor:
    """Images (B, C, H, W) in [0, 1] of expert samples, in the memory layout of augmented ones."""
    return augment(expert.images(rows), SETS["none"], np.random.default_rng(0))


def save_expert_reconstructions(
    run: Run, ppo: PPOTrainer, expert: ExpertData, autoencoder: Autoencoder
) -> None:
    """Save a picture of reconstructed expert frames in the run folder."""
    rows = np.linspace(0, len(expert) - 1, NUM_RECONSTRUCTIONS).astype(np.int64)
    images = unaugmented(expert, rows)
    with torch.no_grad(), ppo.compute.autocast():
        reconstructed, _ = autoencoder(images, expert.labels(rows)[0])
    save_reconstructions(run.folder / PICTURE, images, reconstructed)


def make_autoencoder(config: ALConfig) -> Autoencoder:
    """The autoencoder, initialised from the seed."""
    with seeded_init(config.seed, AUTOENCODER_INIT):
        return Autoencoder(config.networks, config.input_shape, linear_features=config.refined)


ALGORITHM = Algorithm(ALConfig, train, make_policy)
