"""Apprenticeship learning by matching feature expectations (appendix B). Single-task only.

First an autoencoder is trained on the expert's samples; its encoder phi is then frozen. Each update

1. collects a rollout with the current policy (the novice) and adds it to a replay buffer;
2. computes in closed form the weights w that best separate the mean features of expert and novice;
3. updates the policy by PPO with the normalised reward w^T phi(s, a).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Adam

from magical.errors import InvalidConfigError
from magical.scene import NUM_ACTIONS
from magical_baselines.algorithms.gail import sample_batch
from magical_baselines.algorithms.ppo import (
    PUBLISHED_CODE,
    QUICK,
    PPOTrainer,
    ReinforcementConfig,
    make_policy,
)
from magical_baselines.augmentation.augment import augment, to_unit
from magical_baselines.config import (
    Algorithm,
    DemonstrationConfig,
    PositiveFloat,
    PositiveInt,
    augment_option,
    option,
)
from magical_baselines.data import ExpertData, RecentRollouts, load_demonstrations
from magical_baselines.models import Trunk
from magical_baselines.rollouts import RewardNormaliser
from magical_baselines.training import Averages, Purpose, Run, gradient_step, seeded_init, stream

AUTOENCODER_INIT = 1  # number of the initialisation; the policy's is 0
WEIGHT_NORM = 2.0  # of w (appendix B, equation 1)
LOG_EVERY = 50  # batches of pretraining
PASSED = 12  # samples each of expert and novice that the published code encodes in training mode
CHUNK = 64  # samples per forward pass without gradients or batch statistics
# The autoencoder (docs/specification.md, section 10).
FEATURES = 32
HIDDEN = 128
START = (64, 6, 6)  # channels, rows, columns of the input of the decoder's convolutions
DOUBLINGS = ((64, 64), (64, 32), (32, 32), (32, None))  # output channels; None: the image's
SIZE = START[1] * 2 ** len(DOUBLINGS)  # pixels


@dataclass(frozen=True, kw_only=True)
class ALConfig(DemonstrationConfig, ReinforcementConfig):
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
        },
        "published-code": {
            **PUBLISHED_CODE,
            "pretraining_batch_size": 12,
            "augment": "all",
            "feature_samples": 264,
        },
    }

    algorithm: str = "al"
    pretraining_batches: PositiveInt = option(8192, "batches of pretraining the autoencoder")
    pretraining_batch_size: PositiveInt = option(24, "expert samples per pretraining batch")
    pretraining_learning_rate: PositiveFloat = option(
        3e-4, "Adam's learning rate for the autoencoder"
    )
    augment: str = augment_option(
        "none", "the autoencoder's images; of w's instead by the published code's conventions"
    )
    feature_samples: PositiveInt = option(
        512, "samples of the expert, and as many of the novice, to compute w from"
    )
    reward_std: PositiveFloat = option(0.1, "standard deviation of the normalised rewards")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_one_task()
        if self.input_shape[1:] != (SIZE, SIZE):
            raise InvalidConfigError(
                f"observation: expected images of {SIZE} pixels, found {self.input_shape[1:]}"
            )

    @property
    def num_updates(self) -> int:
        return self.pretraining_batches + self.policy_updates


def train(config: ALConfig, run: Run) -> None:
    """Pretrain the autoencoder, then imitate demonstrations."""
    demonstrations = load_demonstrations(config, run)
    with PPOTrainer(config, run) as ppo:
        device = ppo.device
        expert = ExpertData(demonstrations, config.tasks, config.observation_spec, device=device)
        autoencoder = make_autoencoder(config).to(device)
        optimizer = Adam(autoencoder.parameters(), config.pretraining_learning_rate, fused=True)
        novice = RecentRollouts(ppo.envs.task_of, device)
        normaliser = RewardNormaliser(1, config.reward_std, published=config.published).to(device)
        run.keep(
            autoencoder=autoencoder,
            autoencoder_optimizer=optimizer,
            replay_buffer=novice,
            reward_statistics=normaliser,
        )
        if not pretrain(config, run, expert, autoencoder, optimizer):
            return
        autoencoder.eval().requires_grad_(False)

        def encode(images: Tensor, actions: Tensor) -> Tensor:
            with torch.no_grad(), run.compute.autocast():
                features: Tensor = autoencoder.encoder(images, actions)
            return features.float()

        for update in ppo.remaining_updates():
            # Collect a rollout.
            rollout = ppo.collect_rollout(update)
            with ppo.monitor.timed("features"):
                novice.add(rollout.observations, rollout.actions)
                # Compute w from features of both, and the rewards.
                batch = sample_features_batch(config, expert, novice, update)
                chunks = zip(*(torch.split(part, CHUNK) for part in batch), strict=True)
                features = torch.cat([encode(images, actions) for images, actions in chunks])
                if config.published:  # batch norm's statistics adapt to the novice's images
                    autoencoder.train()
                    encode(*(torch.cat([p[:PASSED] for p in part.chunk(2)]) for part in batch))
                    autoencoder.eval()
                w, distance = feature_weights(*features.chunk(2))
                pairs = zip(rollout.observations, rollout.actions, strict=True)
                raw = torch.stack([encode(to_unit(o), a) @ w for o, a in pairs])  # (T, N)
            # Update the policy.
            metrics = ppo.improve_policy(update, rollout, raw, normaliser)
            metrics["feature_distance"] = distance.item()
            if ppo.finish_update(update, metrics):
                break


def pretrain(
    config: ALConfig, run: Run, expert: ExpertData, autoencoder: "Autoencoder", optimizer: Adam
) -> bool:
    """Train the autoencoder on the expert's samples; false if the run stops before the end."""
    averages = Averages()
    augmentations = config.augmentations("none" if config.published else config.augment)
    scale = autoencoder.scale**2  # the error is of pixels in the encoder's range
    for number in range(run.step, config.pretraining_batches):
        rng = stream(config.seed, Purpose.PRETRAINING, number)
        rows = expert.sample_counts([config.pretraining_batch_size], rng)
        images, (actions, _) = augment(expert.images(rows), augmentations, rng), expert.labels(rows)
        with run.compute.autocast():
            reconstructed, logits = autoencoder(images, actions)
        image_error, action_loss = autoencoder_loss(images, actions, reconstructed, logits)
        gradient_step(optimizer, image_error / scale + action_loss)
        averages.add(1, image_error=image_error, action_loss=action_loss)
        done = number + 1
        last = done == config.pretraining_batches
        if run.finish_step(done, averages.reset, log_every=LOG_EVERY, last=last):
            return False
    return True


def sample_features_batch(
    config: ALConfig, expert: ExpertData, novice: RecentRollouts, update: int
) -> tuple[Tensor, Tensor]:
    """Images and actions to compute w from: the expert's, then as many of the novice's."""
    rng = stream(config.seed, Purpose.DISCRIMINATOR, update)
    batch = sample_batch(expert, novice, [config.feature_samples], rng)
    augmentations = config.augmentations(config.augment if config.published else "none")
    return augment(batch.images, augmentations, rng), batch.actions


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


def make_autoencoder(config: ALConfig) -> "Autoencoder":
    """The autoencoder, initialised from the seed."""
    with seeded_init(config.seed, AUTOENCODER_INIT):
        return Autoencoder(config)


class Autoencoder(nn.Module):
    """Encodes images (B, C, 96, 96) and actions (B,) as features (B, 32), and decodes them."""

    def __init__(self, config: ALConfig) -> None:
        """Build an autoencoder, with PyTorch's initialisation.

        The encoder is the discriminator's network with its last layer removed and the layer before
        it set to 32 units. Under the published code's conventions, the image decoder has another
        linear layer, batch norm before each ReLU, and mirrored borders. The decoded pixels are in
        [0, 1] whatever the range of the encoder's.
        """
        super().__init__()
        image_shape, published = config.input_shape, config.published
        self.encoder = Trunk(
            config.network,
            image_shape,
            batch_norm=True,
            action_input=config.action_input,
            num_features=FEATURES,
            pixel_range=config.pixel_range,
        )
        self.hidden = nn.Sequential(
            nn.Linear(FEATURES, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU()
        )
        self.action = nn.Linear(HIDDEN, NUM_ACTIONS)
        start = nn.Linear(HIDDEN, int(np.prod(START)))
        self.start = nn.Sequential(nn.Linear(HIDDEN, HIDDEN), start) if published else start
        self.image = _image_decoder(image_shape[0], published)
        self.scale = 0.5 if published else 1.0  # from the encoder's range of pixels to [0, 1]
        self.middle = 0.5 if published else 0.0  # where the encoder's pixels are 0
        # Convolutions are fastest with this memory layout; PyTorch's typed overloads lack it.
        self.image.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, images: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return reconstructed images (B, C, 96, 96) and logits of the actions (B, 18)."""
        hidden = self.hidden(self.encoder(images, actions))
        start = self.start(hidden).view(-1, *START)
        difference = self.image(start.contiguous(memory_format=torch.channels_last))
        return self.scale * difference.float() + self.middle, self.action(hidden)


def _image_decoder(channels: int, published: bool) -> nn.Sequential:
    """A module from feature maps (B, 64, 6, 6) to images (B, channels, 96, 96)."""
    borders: Literal["reflect", "zeros"] = "reflect" if published else "zeros"
    layers: list[nn.Module] = []
    inputs = START[0]
    for doubled, last in DOUBLINGS:
        layers.append(nn.Upsample(scale_factor=2, mode="nearest"))
        for outputs in (doubled, last):
            convolution = nn.Conv2d(inputs, outputs or channels, 3, padding=1, padding_mode=borders)
            layers.append(convolution)
            if outputs:
                layers += [nn.BatchNorm2d(outputs)] if published else []
                layers.append(nn.ReLU())
                inputs = outputs
    return nn.Sequential(*layers)


def autoencoder_loss(
    images: Tensor, actions: Tensor, reconstructed: Tensor, logits: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the terms of the loss: mean squared image error and cross-entropy of the actions."""
    error = functional.mse_loss(reconstructed.float(), images)
    return error, functional.cross_entropy(logits.float(), actions)


ALGORITHM = Algorithm(ALConfig, train, make_policy)
