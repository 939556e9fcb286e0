"""Apprenticeship learning by matching feature expectations (appendix B). Single-task only.

First an autoencoder is trained on the expert's samples; its encoder phi is then frozen. Each update

1. collects a rollout with the present policy (the novice) and adds its features to a replay buffer;
2. computes the weights w that best separate the mean features of expert and novice, in closed form;
3. updates the policy by PPO with the normalised reward w^T phi(s, a).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.optim import Adam

from magical.errors import InvalidConfigError
from magical.learning.algorithms import Algorithm
from magical.learning.algorithms.ppo import PPOTrainer
from magical.learning.augment import augment, to_unit
from magical.learning.augmentations import parse_augmentations
from magical.learning.autoencoder import SIZE, Autoencoder, save_reconstructions
from magical.learning.checkpoints import StateDict, load_module, load_optimizer, optimizer_state
from magical.learning.config import ImitationConfig, option
from magical.learning.expert_data import ExpertData, Rows, load_demonstrations
from magical.learning.models import make_actor_critic
from magical.learning.reinforcement import QUICK, ReinforcementConfig
from magical.learning.replay_buffer import ReplayBuffer
from magical.learning.reward_normalisation import RewardNormaliser
from magical.learning.run import Run
from magical.learning.streams import Purpose, seeded_init, stream

AUTOENCODER_INIT = 1  # number of the initialisation; the policy's is 0
WEIGHT_NORM = 2.0  # of w (appendix B, equation 1)
LOG_EVERY, CHECKPOINT_EVERY = 50, 500  # batches of pretraining
NUM_RECONSTRUCTIONS = 10  # frames in the picture
PICTURE = "reconstructions.png"
CHUNK = 64  # samples per forward pass without gradients

Encode = Callable[[Tensor, Tensor], Tensor]  # images (B, C, H, W), actions (B,) -> features (B, 32)


@dataclass(frozen=True, kw_only=True)
class ALConfig(ReinforcementConfig, ImitationConfig):
    """Settings of apprenticeship learning; the defaults are appendix B's and Table 4's."""

    algorithm: ClassVar[str] = "al"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            **QUICK,
            "total_steps": 45_000,
            "discount": 0.95,
            "entropy_bonus": 3e-3,
            "pretraining_batches": 1500,
            "pretraining_learning_rate": 1e-3,
            "augment": "noise+translation+rotation",
        },
    }

    pretraining_batches: int = option(8192, "batches that the autoencoder is trained on")
    pretraining_batch_size: int = option(24, "expert samples per such batch")
    pretraining_learning_rate: float = option(3e-4, "Adam's, for the autoencoder")
    augment: str = option(
        "none",
        "of the autoencoder's images: all, none, no-trans-rot, or names joined by +",
        metavar="NAMES",
    )
    feature_samples: int = option(512, "samples, each of expert and novice, to compute w from")
    reward_std: float = option(0.1, "standard deviation of the normalised rewards")
    replay_batches: int = option(4, "rollouts in the replay buffer of novice samples")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("pretraining_batches", "pretraining_batch_size")
        self.require_positive("pretraining_learning_rate", "feature_samples")
        self.require_positive("reward_std", "replay_batches")
        self.require_augmentations("augment")
        self.require_one_task()
        if self.input_shape[1:] != (SIZE, SIZE):
            raise InvalidConfigError(
                f"observation: expected images of {SIZE} pixels, found {self.input_shape[1:]}"
            )

    @property
    def total(self) -> int:
        """The batches of pretraining and the updates."""
        return self.pretraining_batches + self.updates

    @property
    def training_samples(self) -> int:
        """Those of the autoencoder, with a decoder as large as the encoder, and of the policy."""
        pretraining = self.pretraining_batches * self.pretraining_batch_size
        return 2 * pretraining + super().training_samples


def train(config: ALConfig, run: Run) -> None:
    """Pretrain the autoencoder, then imitate demonstrations."""
    demonstrations = load_demonstrations(config, run)
    with PPOTrainer(config, run, previous_steps=config.pretraining_batches) as ppo:
        expert = ExpertData(
            demonstrations, config.tasks, config.observation_spec, device=ppo.device
        )
        autoencoder = make_autoencoder(config).to(ppo.device)
        if not pretrain(config, run, ppo, expert, autoencoder):
            return
        autoencoder.eval().requires_grad_(False)
        draw_reconstructions(run, ppo, expert, autoencoder)
        imitate(config, run, ppo, expert, autoencoder)


def pretrain(
    config: ALConfig, run: Run, ppo: PPOTrainer, expert: ExpertData, autoencoder: Autoencoder
) -> bool:
    """Train the autoencoder on the expert's samples; false if the run stops before the end."""
    optimizer = Adam(autoencoder.parameters(), config.pretraining_learning_rate, fused=True)
    if run.saved:
        load_module(autoencoder, run.saved["autoencoder"], str(run.folder))
        if "autoencoder_optimizer" in run.saved:
            load_optimizer(optimizer, run.saved["autoencoder_optimizer"])
    augmentations = parse_augmentations(config.augment)
    for number in range(run.step, config.pretraining_batches):
        rng = stream(config.seed, Purpose.PRETRAINING, number)
        rows = expert.sample_counts([config.pretraining_batch_size], rng)
        images = augment(expert.images(rows), augmentations, rng)
        actions, _ = expert.labels(rows)
        with ppo.compute.autocast():
            reconstructed, logits = autoencoder(images, actions)
        image_error, action_loss = autoencoder_loss(images, actions, reconstructed, logits)
        optimizer.zero_grad()
        torch.autograd.backward(image_error + action_loss)
        optimizer.step()

        done = number + 1
        stops = run.stops(done)
        last = stops or done == config.pretraining_batches
        if last or done % LOG_EVERY == 0:
            metrics = {"image_error": image_error.item(), "action_loss": action_loss.item()}
            run.log(done, config.total, **metrics)
            run.require_finite(done, metrics)
        if last or done % CHECKPOINT_EVERY == 0:
            state = {
                "policy": ppo.network.state_dict(),
                "autoencoder": autoencoder.state_dict(),
                "autoencoder_optimizer": optimizer_state(optimizer),
            }
            run.checkpoint(done, state)
        if stops:
            return False
    return True


def autoencoder_loss(
    images: Tensor, actions: Tensor, reconstructed: Tensor, logits: Tensor
) -> tuple[Tensor, Tensor]:
    """Mean squared image error and cross-entropy of the actions; their sum is to be minimised."""
    error = functional.mse_loss(reconstructed.float(), images)
    return error, functional.cross_entropy(logits.float(), actions)


def imitate(
    config: ALConfig, run: Run, ppo: PPOTrainer, expert: ExpertData, autoencoder: Autoencoder
) -> None:
    """Compute w and update the policy, in alternation."""

    def encode(images: Tensor, actions: Tensor) -> Tensor:
        with torch.no_grad(), ppo.compute.autocast():
            features: Tensor = autoencoder.encoder(images, actions)
        return features.float()

    expert_features = encode_expert(expert, encode)  # (S, 32)
    replay_buffer = ReplayBuffer(config.replay_batches, ppo.envs.task_of)
    normaliser = RewardNormaliser(1, config.reward_std, ppo.device)
    if run.saved and "apprentice" in run.saved:
        saved = run.saved["apprentice"]
        replay_buffer.load_state_dict(saved["replay_buffer"], ppo.device)
        normaliser.load_state_dict(saved["reward_statistics"])

    def state_dict() -> StateDict:
        apprentice = {
            "replay_buffer": replay_buffer.state_dict(),
            "reward_statistics": normaliser.state_dict(),
        }
        return {"autoencoder": autoencoder.state_dict(), "apprentice": apprentice}

    for update in ppo.remaining_updates():
        rollout = ppo.collect_rollout(update)
        with ppo.monitor.timed("features"):
            pairs = zip(rollout.observations, rollout.actions, strict=True)
            features = torch.stack([encode(to_unit(o), a) for o, a in pairs])  # (T, N, 32)
            replay_buffer.add(features, rollout.actions)
            rng = stream(config.seed, Purpose.DISCRIMINATOR, update)
            rows = torch.from_numpy(expert.sample_counts([config.feature_samples], rng))
            novice_features, _, _ = replay_buffer.sample([config.feature_samples], rng)
            w, distance = feature_weights(expert_features[rows.to(ppo.device)], novice_features)
            raw = features @ w  # (T, N)
            rewards = normaliser(raw, rollout.tasks)
        metrics = ppo.improve_policy(update, rollout, rewards)
        metrics |= {
            "raw_reward": raw.mean().item(),
            "raw_reward_std": raw.std(correction=0).item(),
            "feature_distance": distance.item(),
        }
        if ppo.finish_update(update, metrics, state_dict):
            break


def feature_weights(expert: Tensor, novice: Tensor) -> tuple[Tensor, Tensor]:
    """Maximise w^T (mean expert - mean novice) over |w|_2 <= 2, for features (B, 32) of each.

    By Cauchy-Schwarz w is parallel to the difference of the means; it is 0 if there is none.

    Returns:
        w (32,) and the maximum, a scalar.
    """
    difference = expert.mean(dim=0) - novice.mean(dim=0)
    length = difference.norm()
    w = WEIGHT_NORM * difference / length.clamp(min=torch.finfo(length.dtype).tiny)
    return w, WEIGHT_NORM * length


def encode_expert(expert: ExpertData, encode: Encode) -> Tensor:
    """The features (S, 32) of all expert samples."""
    parts = []
    for first in range(0, len(expert), CHUNK):
        rows = np.arange(first, min(first + CHUNK, len(expert)))
        parts.append(encode(unaugmented(expert, rows), expert.labels(rows)[0]))
    return torch.cat(parts)


def unaugmented(expert: ExpertData, rows: Rows) -> Tensor:
    """Images (B, C, H, W) in [0, 1] of expert samples, in the memory layout of augmented ones."""
    return augment(expert.images(rows), parse_augmentations("none"), np.random.default_rng(0))


def draw_reconstructions(
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
        return Autoencoder(config.network, config.input_shape)


ALGORITHM = Algorithm(ALConfig, train, make_actor_critic)
