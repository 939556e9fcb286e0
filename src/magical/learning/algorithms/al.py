"""Apprenticeship learning by matching feature expectations (appendix B).

First an autoencoder learns features from the expert's samples, and is then frozen. Then the
weights w that tell the expert's mean features from the novice's best, in closed form, and PPO on
the reward w^T phi take turns. Single-task only.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.optim import Adam

from magical.errors import InvalidConfigError
from magical.learning.algorithms import Algorithm
from magical.learning.algorithms.ppo import Learner, make_policy
from magical.learning.augment import augment, parse_augmentations
from magical.learning.autoencoder import (
    SIZE,
    Autoencoder,
    autoencoder_loss,
    save_reconstructions,
)
from magical.learning.checkpoints import load_module, load_optimizer, optimizer_tree
from magical.learning.config import ImitationConfig, option
from magical.learning.expert_data import ExpertData, choose_demonstrations
from magical.learning.networks import get_width
from magical.learning.reinforcement import QUICK, ReinforcementConfig
from magical.learning.replay import Replay
from magical.learning.reward_normalisation import RewardNormaliser
from magical.learning.rollout import as_inputs
from magical.learning.runs import Run
from magical.learning.streams import Purpose, seeded_weights, stream

WEIGHTS_NUMBER = 1  # the policy's first weights are number 0 of the seed
NORM = 2.0  # of w (appendix B, equation 1)
LOG_EVERY, CHECKPOINT_EVERY = 50, 500  # batches of pretraining
SHOWN = 10  # frames in the picture of reconstructions
PICTURE = "reconstructions.png"
CHUNK = 64  # images at a time where no gradients are needed


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

    pretraining_batches: int = option(8192, "batches that the autoencoder learns from")
    pretraining_batch_size: int = option(24, "expert samples in such a batch")
    pretraining_learning_rate: float = option(3e-4, "Adam's step size for the autoencoder")
    augment: str = option(
        "none", "of the autoencoder's images: all, none, no-trans-rot, or names joined by +"
    )
    feature_samples: int = option(512, "samples, each of expert and novice, that give w")
    reward_std: float = option(0.1, "standard deviation that rewards are normalised to")
    replay_batches: int = option(4, "sampler batches that novice samples are drawn from")

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
        """Batches of pretraining, then updates."""
        return self.pretraining_batches + self.updates


def train(config: ALConfig, run: Run) -> None:
    """Pretrain, then imitate demonstrations."""
    chosen = choose_demonstrations(config.demos, config.tasks, config.num_demos, config.seed)
    run.describe(demonstrations=list(chosen.record))
    with Learner(config, run, before=config.pretraining_batches) as learner:
        expert = ExpertData(
            chosen.trajectories, config.tasks, config.observation_spec, device=learner.device
        )
        autoencoder = make_autoencoder(config).to(learner.device)
        if not pretrain(config, run, learner, expert, autoencoder):
            return
        autoencoder.eval().requires_grad_(False)
        draw_reconstructions(run, learner, expert, autoencoder)
        imitate(config, run, learner, expert, autoencoder)


def pretrain(
    config: ALConfig, run: Run, learner: Learner, expert: ExpertData, autoencoder: Autoencoder
) -> bool:
    """Let the autoencoder learn the expert's samples; whether that was finished."""
    optimizer = Adam(autoencoder.parameters(), config.pretraining_learning_rate, fused=True)
    if run.saved:
        load_module(autoencoder, run.saved["autoencoder"], str(run.folder))
        if "autoencoder_optimizer" in run.saved:
            load_optimizer(optimizer, run.saved["autoencoder_optimizer"])
    augmentations = parse_augmentations(config.augment)
    for number in range(run.step, config.pretraining_batches):
        rng = stream(config.seed, Purpose.PRETRAINING, number)
        rows = expert.sample_evenly(config.pretraining_batch_size, rng)
        images = augment(expert.images(rows), augmentations, rng)
        actions, _ = expert.labels(rows)
        with learner.compute.autocast():
            reconstructed, logits = autoencoder(images, actions)
        image_error, action_loss = autoencoder_loss(images, actions, reconstructed, logits)
        optimizer.zero_grad()
        torch.autograd.backward(image_error + action_loss)
        optimizer.step()

        done = number + 1
        stops = run.stops(done)
        ends = stops or done == config.pretraining_batches
        if ends or done % LOG_EVERY == 0:
            metrics = {"image_error": image_error.item(), "action_loss": action_loss.item()}
            run.log(done, config.total, **metrics)
            run.require_finite(done, metrics)
        if ends or done % CHECKPOINT_EVERY == 0:
            tree = {
                "policy": learner.network.state_dict(),
                "autoencoder": autoencoder.state_dict(),
                "autoencoder_optimizer": optimizer_tree(optimizer),
            }
            run.checkpoint(done, tree)
        if stops:
            return False
    return True


def imitate(
    config: ALConfig, run: Run, learner: Learner, expert: ExpertData, autoencoder: Autoencoder
) -> None:
    """Weights and policy in turns."""

    def encode(images: Tensor, actions: Tensor) -> Tensor:
        with torch.no_grad(), learner.compute.autocast():
            features: Tensor = autoencoder.encoder(images, actions)
        return features.float()

    expert_features = encode_expert(expert, encode)  # (S, 32)
    replay = Replay(config.replay_batches, learner.sampler.task_of)
    normaliser = RewardNormaliser(1, config.reward_std, learner.device)
    if run.saved and "apprentice" in run.saved:
        replay.load(run.saved["apprentice"]["replay"], learner.device)
        normaliser.load(run.saved["apprentice"]["reward_statistics"])

    def tree() -> dict[str, Any]:
        apprentice = {"replay": replay.tree(), "reward_statistics": normaliser.tree()}
        return {"autoencoder": autoencoder.state_dict(), "apprentice": apprentice}

    for number in learner.numbers():
        samples = learner.collect(number)
        began = time.perf_counter()
        shown = zip(samples.observations, samples.actions, strict=True)
        features = torch.stack([encode(as_inputs(o), a) for o, a in shown])
        replay.add(features, samples.actions)  # (T, N, 32)
        rng = stream(config.seed, Purpose.DISCRIMINATOR, number)
        rows = torch.from_numpy(expert.sample_evenly(config.feature_samples, rng))
        novice, _, _ = replay.sample_evenly(config.feature_samples, rng)
        weights, distance = feature_weights(expert_features[rows.to(learner.device)], novice)
        raw = features @ weights
        rewards = normaliser(raw, samples.tasks)
        took = time.perf_counter() - began

        metrics = learner.improve(number, samples, rewards)
        metrics |= {
            "raw_reward": raw.mean().item(),
            "raw_reward_std": raw.std(correction=0).item(),
            "feature_distance": distance.item(),
        }
        if learner.finish(number, metrics, tree, features=took):
            break


def feature_weights(expert: Tensor, novice: Tensor) -> tuple[Tensor, Tensor]:
    """The w of norm 2 with the largest w^T (mean expert - mean novice), and that maximum.

    The features are (B, 32) each. By Cauchy-Schwarz w points along the difference of means; where
    there is none, w is 0.
    """
    difference = expert.mean(dim=0) - novice.mean(dim=0)
    length = difference.norm()
    weights = NORM * difference / length.clamp(min=torch.finfo(length.dtype).tiny)
    return weights, NORM * length


def encode_expert(expert: ExpertData, encode: Any) -> Tensor:
    """Features (S, 32) of all of the expert's samples."""
    parts = []
    for first in range(0, len(expert), CHUNK):
        rows = np.arange(first, min(first + CHUNK, len(expert)))
        images = augment(expert.images(rows), parse_augmentations("none"), np.random.default_rng(0))
        parts.append(encode(images, expert.labels(rows)[0]))
    return torch.cat(parts)


def draw_reconstructions(
    run: Run, learner: Learner, expert: ExpertData, autoencoder: Autoencoder
) -> None:
    """The picture of what the autoencoder makes of some expert frames."""
    rows = np.linspace(0, len(expert) - 1, SHOWN).astype(np.int64)
    images = augment(expert.images(rows), parse_augmentations("none"), np.random.default_rng(0))
    with torch.no_grad(), learner.compute.autocast():
        reconstructed, _ = autoencoder(images, expert.labels(rows)[0])
    save_reconstructions(run.folder / PICTURE, images, reconstructed)


def make_autoencoder(config: ALConfig) -> Autoencoder:
    """The network, with first weights from the seed."""
    with seeded_weights(config.seed, WEIGHTS_NUMBER):
        return Autoencoder(get_width(config.network), config.input_shape)


ALGORITHM = Algorithm(ALConfig, train, make_policy)
