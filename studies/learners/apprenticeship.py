"""What limits apprenticeship learning: its features, its weights w, or learning from pixels.

    magical train al --task MoveToRegion --demos demos --preset quick --out runs/al
    python studies/learners/apprenticeship.py --run runs/al --metric covariance

Imitates MoveToRegion-Demo with rewards w^T phi from images, as `magical train al` does, but by a
small policy on the robot's pose, whose updates cost a tenth. phi is the run's autoencoder, or
(`--features components`) the first principal components of the expert's images. The run may be one
that was stopped after its pretraining. Needs magical-baselines.
"""

import argparse
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from magical.envs.vector import MagicalVectorEnv
from magical.runs.folder import CHECKPOINT
from magical.scene import NUM_ACTIONS
from magical.scene.poses import FINGERS, ROBOT
from magical_baselines.algorithms import read_config
from magical_baselines.algorithms.al import WEIGHTS, ALConfig, make_autoencoder
from magical_baselines.algorithms.ppo import make_samples, ppo_loss
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.data.expert_data import ExpertData, sample_demonstrations
from magical_baselines.reinforcement.replay_buffer import ROLLOUTS
from magical_baselines.reinforcement.reward_normalisation import RewardNormaliser, reward_floor
from magical_baselines.reinforcement.rollouts import Rollout
from magical_baselines.running.checkpoints import load_checkpoint

DEMO, HORIZON = "magical/MoveToRegion-Demo-v0", 40
POSE = 12  # position, cosine and sine of the angle, the fingers' angles, and changes of all these
CHANGES = 5.0  # factor of the changes, which are small
LEARNING_RATE = 1e-3
CHUNK = 64

Encode = Callable[[Tensor, Tensor], Tensor]  # images (B, C, H, W), actions (B,) -> features (B, F)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", type=Path, required=True, help="run folder of `train al`")
    parser.add_argument("--features", choices=("encoder", "components"), default="encoder")
    parser.add_argument("--metric", choices=tuple(WEIGHTS), default="covariance")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--steps", type=int, default=25_600)
    args = parser.parse_args()
    torch.set_num_threads(1)
    config = read_config(args.run)
    assert isinstance(config, ALConfig)
    wanted = config.demonstrations
    chosen = sample_demonstrations(wanted.demos, config.tasks, wanted.num_demos, config.seed)
    expert = ExpertData(chosen.trajectories, config.tasks, config.observation_spec)
    encoder = args.features == "encoder"
    encode = load_encoder(config, args.run) if encoder else principal_components(expert)
    for seed in args.seeds:
        score = imitate(config, expert, encode, args.metric, seed, args.steps)
        print(f"{args.features}, {args.metric}, seed {seed}: {score:.2f}", flush=True)


def load_encoder(config: ALConfig, folder: Path) -> Encode:
    """The run's encoder."""
    autoencoder = make_autoencoder(config)
    autoencoder.load_state_dict(load_checkpoint(folder / CHECKPOINT)["autoencoder"])
    encoder = autoencoder.eval().encoder
    return lambda images, actions: encoder(images, actions)


def principal_components(expert: ExpertData, number: int = 32) -> Encode:
    """Coordinates along the first principal components of the images at half their resolution."""

    def flat(images: Tensor) -> Tensor:
        return functional.avg_pool2d(images, 2).flatten(1)

    images = flat(to_unit(expert.images(np.arange(len(expert)))))
    mean = images.mean(dim=0)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        _, _, components = torch.svd_lowrank(images - mean, number)
    return lambda images, actions: (flat(images) - mean) @ components


class PoseActorCritic(nn.Module):
    """Logits (B, 18) and values (B,) from the robot's pose (B, 12)."""

    def __init__(self) -> None:
        super().__init__()
        self.hidden = nn.Sequential(nn.Linear(POSE, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh())
        self.policy, self.value = nn.Linear(128, NUM_ACTIONS), nn.Linear(128, 1)
        with torch.no_grad():
            self.policy.weight.mul_(0.01)  # nearly uniform actions

    def forward(self, poses: Tensor) -> tuple[Tensor, Tensor]:
        hidden = self.hidden(poses)
        return self.policy(hidden), self.value(hidden).squeeze(1)


class PoseEnvs:
    """Environments that show images, for the rewards, and the robot's pose, for the policy."""

    def __init__(self, config: ALConfig, rng: np.random.Generator) -> None:
        size = config.ppo.num_envs
        self.envs = MagicalVectorEnv(
            [DEMO] * size, workers=0, observation=config.observation, autoreset_mode="SameStep"
        )
        self._spec = config.observation_spec
        seeds = [int(seed) for seed in rng.integers(2**31, size=size)]
        self._observations, _ = self.envs.reset(seed=seeds)
        delays = rng.integers(HORIZON, size=size)
        for time in range(delays.max()):
            actions = rng.integers(NUM_ACTIONS, size=size)
            self._observations, *_ = self.envs.step(actions, active=time < delays)
        self.scores: deque[float] = deque(maxlen=100)
        self._previous = self._pose()
        self.poses = self._with_changes(np.ones(size, np.bool_))

    def images(self) -> Tensor:
        """Network inputs (N, C, H, W)."""
        return torch.from_numpy(self._spec.network_input(self._observations))

    def step(self, actions: Tensor) -> NDArray[np.bool_]:
        """Take actions (N,); returns which episodes ended."""
        self._observations, _, _, dones, infos = self.envs.step(actions.numpy())
        if dones.any():
            self.scores.extend(infos["final_info"]["eval_score"][dones].tolist())
        self.poses = self._with_changes(dones)
        return np.asarray(dones)

    def _pose(self) -> NDArray[np.float64]:
        bodies, _ = self.envs.bodies  # (N, bodies, 6)
        x, y, angle = bodies[:, ROBOT, :3].T
        fingers = bodies[:, FINGERS, 2] - angle[:, None]
        fingers = (fingers + np.pi) % (2 * np.pi) - np.pi
        return np.column_stack([x, y, np.cos(angle), np.sin(angle), fingers])

    def _with_changes(self, started: NDArray[np.bool_]) -> Tensor:
        pose = self._pose()
        changes = np.where(started[:, None], 0.0, pose - self._previous)
        self._previous = pose
        return torch.from_numpy(np.concatenate([pose, CHANGES * changes], axis=1)).float()


def imitate(
    config: ALConfig, expert: ExpertData, encode: Encode, metric: str, seed: int, steps: int
) -> float:
    """Apprenticeship learning; returns the mean score of the last 100 episodes."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    envs, network = PoseEnvs(config, rng), PoseActorCritic()
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    normaliser = RewardNormaliser(1, config.reward_std, reward_floor(config.networks))
    expert_features = encode_expert(expert, encode)
    novice: deque[Tensor] = deque(maxlen=ROLLOUTS)
    updates = steps // config.ppo.steps_per_update
    for update in range(updates):
        rollout, features = collect_rollout(config, envs, network, encode)
        novice.append(features.flatten(0, 1))
        w, distance = WEIGHTS[metric](expert_features, torch.cat(list(novice)))
        rewards = normaliser(features @ w, rollout.tasks)
        improve_policy(config, network, optimizer, rollout, rewards, 1.0 - update / updates, rng)
        if (update + 1) % 10 == 0 and envs.scores:
            score = np.mean(envs.scores)
            print(f"  update {update + 1}: {score:.2f}, distance {distance:.1f}", flush=True)
    envs.envs.close()
    return float(np.mean(envs.scores))


@torch.no_grad()
def encode_expert(expert: ExpertData, encode: Encode) -> Tensor:
    """The features (S, F) of all expert samples."""
    chunks = np.array_split(np.arange(len(expert)), -(-len(expert) // CHUNK))
    return torch.cat([encode(to_unit(expert.images(c)), expert.labels(c)[0]) for c in chunks])


@torch.no_grad()
def collect_rollout(
    config: ALConfig, envs: PoseEnvs, network: PoseActorCritic, encode: Encode
) -> tuple[Rollout, Tensor]:
    """A rollout whose observations are poses, and its features (T, N, F)."""
    poses, taken, log_probs, values, dones, features = [], [], [], [], [], []
    for _ in range(config.ppo.num_steps):
        images = envs.images()
        logits, value = network(envs.poses)
        policy = logits.log_softmax(dim=1)
        actions = torch.multinomial(policy.exp(), 1)  # (N, 1)
        poses.append(envs.poses)
        taken.append(actions[:, 0])
        log_probs.append(policy.gather(1, actions)[:, 0])
        values.append(value)
        features.append(encode(to_unit(images), actions[:, 0]))
        dones.append(torch.from_numpy(envs.step(actions[:, 0])))
    ends, before = torch.stack(dones), torch.stack(values)
    # At the time limit the state's own value stands for that of the state after it.
    following = torch.cat([before[1:], network(envs.poses)[1][None]])
    rollout = Rollout(
        observations=torch.stack(poses),
        actions=torch.stack(taken),
        log_probs=torch.stack(log_probs),
        values=before,
        next_values=torch.where(ends, before, following),
        rewards=torch.zeros_like(before),
        dones=ends,
        tasks=torch.zeros(before.shape[1], dtype=torch.int64),
        scores=(),
    )
    return rollout, torch.stack(features)


def improve_policy(
    config: ALConfig,
    network: PoseActorCritic,
    optimizer: torch.optim.Optimizer,
    rollout: Rollout,
    rewards: Tensor,
    left: float,
    rng: np.random.Generator,
) -> None:
    """PPO's update with the run's settings; `left` anneals learning rate and clip range."""
    ppo = config.ppo
    samples = make_samples(rollout, rewards, ppo.gamma, ppo.gae_lambda, ppo.normalise_advantages)
    for group in optimizer.param_groups:
        group["lr"] = LEARNING_RATE * left
    for _ in range(ppo.epochs):
        order = torch.from_numpy(rng.permutation(len(samples.actions)))
        for rows in torch.split(order, ppo.minibatch_size):
            minibatch = samples.select(rows)
            logits, values = network(minibatch.observations)
            clip_range = torch.tensor(ppo.clip_range * left)
            loss, _ = ppo_loss(logits, values, minibatch, clip_range, ppo.ent_coef)
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            nn.utils.clip_grad_norm_(network.parameters(), ppo.max_grad_norm)
            optimizer.step()


if __name__ == "__main__":
    main()
