"""Behavioural cloning, chunks of actions, ACT, diffusion policy, and cloning with memory."""

import math
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from torch.distributions import Normal, kl_divergence

from baselines.tests import tiny_runs
from baselines.tests.conftest import TASKS, picture_demo, write_demos
from baselines.tests.tiny_runs import CPU, tiny
from magical.demos import Trajectory, observations
from magical.envs import EnvId
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import evaluate
from magical.evaluation.rollouts import play
from magical.observe import PRESETS
from magical.physics import Simulation
from magical.scene import NOOP, POINTS, to_continuous
from magical.tasks import get_task
from magical_baselines import NetworkPolicy, find_algorithm, load_policy, train
from magical_baselines.algorithms import act, diffusion, transformer_bc
from magical_baselines.algorithms.act import ACTConfig, ACTPolicy, act_losses
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.cloning import ChunkPolicy, Chunks, sample_chunks
from magical_baselines.algorithms.diffusion import (
    NOISE_LEVELS,
    DiffusionConfig,
    cosine_schedule,
    diffusion_losses,
)
from magical_baselines.algorithms.transformer_bc import (
    WIDTH,
    MemoryPolicy,
    TransformerBCConfig,
    sample_windows,
)
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.data import ExpertData


def bc_config(demos, **fields):
    settings = {"tasks": TASKS[:1], "demos": str(demos), "batches": 6, "checkpoint_every": 2}
    return tiny_runs.tiny(BCConfig, **{**settings, **fields})


def test_one_demonstration_is_overfitted(tmp_path):
    demos = write_demos(tmp_path / "demos", [picture_demo("MoveToCorner", 0)])
    config = bc_config(demos, num_demos=1, batches=80, batch_size=16, augment="none")
    trained = train(config, tmp_path / "run").policy()
    assert isinstance(trained, NetworkPolicy)
    trajectory = picture_demo("MoveToCorner", 0)
    shown = observations(trajectory, "LoRes4E")
    likeliest = trained.probabilities(shown, [trajectory.env_id] * len(shown)).argmax(axis=1)
    kept = trajectory.actions != 0
    assert (likeliest[:-1] == trajectory.actions)[kept].mean() >= 0.99


def test_state_vectors_are_learned_from(tmp_path):
    task, actions = get_task("MoveToRegion"), np.repeat([1, 4], 16)
    simulation = Simulation(task.demo)
    bodies = [simulation.read()]
    for action in actions.tolist():
        simulation.step(POINTS[action])
        bodies.append(simulation.read())
    demo = Trajectory.from_bodies("MoveToRegion-Demo-v0", task.demo, actions, np.stack(bodies))
    demos = write_demos(tmp_path / "demos", [demo])
    fields = {"tasks": ("MoveToRegion",), "observation": "state", "num_demos": 1}
    config = bc_config(demos, **fields, augment="none", batches=300, batch_size=16)
    train(config, tmp_path / "run")
    policy = load_policy(tmp_path / "run", greedy=True)
    states = observations(demo, "state")[:-1]
    found = policy.act(states, ["MoveToRegion-Demo-v0"] * len(states), np.random.default_rng(0))
    assert np.mean(found == actions) > 0.9
    assert len(evaluate(policy, ["MoveToRegion-Demo-v0"], rollouts=1, seed=0, workers=0)) == 1


LENGTH = 5


@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_a_chunk_has_the_next_actions_that_are_no_noops_up_to_the_end(space):
    actions = {"MoveToCorner": [3, 0, 0, 4, 5, 9], "MoveToRegion": [7, 8, 0, 10, 11, 12, 13]}
    pairs: list[tuple[str, Trajectory]] = [
        (task, picture_demo(task, 0, actions[task]).with_action_space(space)) for task in TASKS
    ]
    data = ExpertData(pairs, TASKS, PRESETS["LoRes4E"], remove_noops=True)
    sizes = {"batch_size": 64, "chunk": LENGTH}
    config = ACTConfig.preset("quick", tasks=TASKS, demos="", augment="none", **sizes)
    batch = sample_chunks(config, data, np.random.default_rng(3))
    steps = set()
    for row, task in enumerate(batch.tasks.tolist()):
        shown = int(batch.images[row, -1, 0, 0] * 255) // 14  # the brightness tells the action
        kept = [action for action in actions[TASKS[task]] if action]
        after = kept[kept.index(shown) :][:LENGTH]
        padded = np.array(after + [kept[-1]] * (LENGTH - len(after)))
        expected = padded if space == "discrete" else to_continuous(padded)
        np.testing.assert_array_equal(batch.actions[row].numpy(), expected)
        assert batch.exist[row].tolist() == [step < len(after) for step in range(LENGTH)]
        steps.add(shown)
    assert steps == {3, 4, 5, 7, 8, 9, 10, 11, 12, 13}
    assert batch.actions.dtype == (torch.int64 if space == "discrete" else torch.float32)


def test_what_follows_another_action_than_the_label_is_unknown():
    trajectory = replace(
        picture_demo("MoveToCorner", 0, [3, 9, 5, 6]), expert_actions=np.array([3, 4, 5, 6])
    )
    data = ExpertData([("MoveToCorner", trajectory)], TASKS[:1], PRESETS["LoRes4E"])
    config = ACTConfig.preset("quick", tasks=TASKS[:1], demos="", batch_size=64, chunk=3)
    batch = sample_chunks(config, data, np.random.default_rng(0))
    found = {
        tuple(map(tuple, torch.stack(each, dim=1).tolist()))
        for each in zip(*batch[1:4], strict=True)
    }
    assert found == {  # pairs of an action, whether it exists, whether it is padding
        ((3, 1, 0), (4, 1, 0), (4, 0, 0)),
        ((4, 1, 0), (4, 0, 0), (4, 0, 0)),
        ((5, 1, 0), (6, 1, 0), (6, 0, 1)),
        ((6, 1, 0), (6, 0, 1), (6, 0, 1)),
    }


class Counting(nn.Module):
    """Chunks whose actions tell the frame's brightness, and their positions in the chunk."""

    def __init__(self, length):
        super().__init__()
        self.length, self.calls = length, 0

    def forward(self, images, tasks):
        self.calls += 1
        frame = images[:, :1, 0, 0] * 255 / 100
        position = torch.arange(self.length) / 100
        return torch.stack([frame.expand(-1, self.length), position.expand(len(frame), -1),
                            frame + position + 0.9], dim=2)  # fmt: skip


def actions_of(policy, frames, starts=()):
    """The actions (T, B, 3) at the brightness of frames (T, B); `starts`: (step, row) of resets."""
    rng, found = np.random.default_rng(0), []
    count = frames.shape[1]
    policy.reset(np.ones(count, np.bool_))
    for step, values in enumerate(frames):
        if rows := [row for when, row in starts if when == step]:
            policy.reset(np.isin(np.arange(count), rows))
        observations = np.broadcast_to(values[:, None, None, None], (count, 96, 96, 12))
        ids = ["magical/MoveToCorner-Demo-v0"] * count
        found.append(policy.act(observations.astype(np.uint8), ids, rng))
    return np.array(found)


def make(kind, **settings):
    config: Any = ACTConfig if kind is ACTPolicy else DiffusionConfig
    space = {"action_space": "continuous"} if kind is ACTPolicy else {}
    made = config.preset("quick", tasks=TASKS, demos="", chunk=LENGTH, **space, **settings)
    return kind(Counting(LENGTH), made, CPU)


@pytest.mark.parametrize("kind", [ChunkPolicy, ACTPolicy])
@pytest.mark.parametrize("execute", [1, 3, LENGTH])
def test_a_new_chunk_replaces_the_rest_of_the_one_before(execute, kind):
    policy = make(kind, execute=execute)
    found = actions_of(policy, np.arange(12)[:, None])
    predicted_at = np.arange(12) // execute * execute
    np.testing.assert_allclose(found[:, 0, 0], predicted_at / 100, atol=1e-6)
    np.testing.assert_allclose(found[:, 0, 1], (np.arange(12) - predicted_at) / 100, atol=1e-6)
    assert policy.network.calls == -(-12 // execute)


@pytest.mark.parametrize("execute", [1, 2])
def test_temporal_ensembling_is_the_published_weighted_mean(execute, monkeypatch):
    """Zhao et al., algorithm 2: w_i = exp(-m i), w_0 of the oldest prediction."""
    decay, frames = 0.3, np.random.default_rng(1).integers(100, size=(12, 2))
    monkeypatch.setattr(act, "ENSEMBLE_DECAY", decay)
    policy = make(ACTPolicy, ensemble=True, execute=execute)
    found = actions_of(policy, frames)
    for step in range(12):
        made = [t for t in range(0, step + 1, execute) if step - t < LENGTH]  # oldest first
        weights = np.exp(-decay * np.arange(len(made)))
        for row in range(2):
            means = weights @ (frames[made, row] / 100) / weights.sum()
            np.testing.assert_allclose(found[step, row, 0], means, atol=1e-6)
    assert found.max() == 1.0  # clipped


@pytest.mark.parametrize("ensemble", [False, True])
def test_episodes_may_start_at_any_time(ensemble):
    frames = np.random.default_rng(2).integers(100, size=(12, 2))
    settings = {"execute": 3, "ensemble": ensemble}
    together = actions_of(make(ACTPolicy, **settings), frames, starts=[(4, 1)])
    first = actions_of(make(ACTPolicy, **settings), frames[:, :1])
    second = actions_of(make(ACTPolicy, **settings), frames[4:, 1:])
    np.testing.assert_array_equal(together[:, 0], first[:, 0])
    np.testing.assert_array_equal(together[4:, 1], second[:, 0])


class Logits(nn.Module):
    """The logits of action 4 or 7 in all steps, by the frame's brightness."""

    def forward(self, images, tasks):
        probabilities = torch.full((len(images), LENGTH, 18), 1e-30)
        dark = images[:, 0, 0, 0] == 0
        probabilities[dark, :, 4] = 1.0
        probabilities[~dark, :, 7] = 1.0
        return probabilities.log()


@pytest.mark.parametrize("greedy", [False, True])
def test_probabilities_of_discrete_actions_are_averaged(greedy):
    """One chunk of four is for action 4; by the mean of logits it would never be chosen."""
    config = ACTConfig.preset("quick", tasks=TASKS, demos="", chunk=LENGTH, ensemble=True)
    policy = ACTPolicy(Logits(), config, CPU, greedy)
    frames = np.zeros((4, 600), np.uint8)
    frames[1:] = 100
    last = actions_of(policy, frames)[-1]
    assert last.dtype == np.int64
    if greedy:
        assert (last == 7).all()
    else:
        assert set(last.tolist()) == {4, 7}
        assert abs((last == 4).mean() - 0.25) < 0.06


CHUNK = 4
SPACES = ("discrete", "continuous")


def act_config(**settings):
    made = {"tasks": TASKS, "demos": "", "chunk": CHUNK, **settings}
    return ACTConfig.preset("quick", **made)


def act_batch(space="discrete"):
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(6, 12, 1, 1, generator=generator).expand(-1, -1, 96, 96)
    actions = torch.randint(18, (6, CHUNK), generator=generator)
    if space == "continuous":
        actions = torch.randint(-1, 2, (6, CHUNK, 3), generator=generator).float()
    exist = torch.ones(6, CHUNK, dtype=torch.bool)
    exist[2, 1:] = False
    return Chunks(images, actions, exist, ~exist, torch.arange(6) % len(TASKS))


def losses(network, samples):
    torch.manual_seed(0)  # of z and of dropout
    found = act_losses(network, samples)
    return {name: value.item() for name, value in found.items()}


def test_the_divergence_is_that_of_normal_distributions():
    mean, log_variance = torch.randn(2, 5, 32, generator=torch.Generator().manual_seed(1))
    expected = kl_divergence(Normal(mean, (0.5 * log_variance).exp()), Normal(0.0, 1.0))
    torch.testing.assert_close(act.kl_divergence(mean, log_variance), expected.sum(dim=1))


@pytest.mark.parametrize("space", SPACES)
def test_what_is_beyond_the_end_does_not_count(space):
    network, samples = act.make_policy(act_config(action_space=space)), act_batch(space)
    padded, seen = samples.actions.clone(), samples.actions.clone()
    padded[2, 1:] = 0
    seen[2, :1] = 0
    before = losses(network, samples)
    assert losses(network, samples._replace(actions=padded)) == pytest.approx(before)
    assert losses(network, samples._replace(actions=seen)) != pytest.approx(before)
    assert before["loss"] == pytest.approx(before["action_loss"] + 10.0 * before["kl"])


def diffusion_config(**settings):
    made = {"tasks": TASKS, "demos": "", "chunk": CHUNK, "execute": 2, **settings}
    return DiffusionConfig.preset("quick", **made)


def diffusion_batch():
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(3, 12, 1, 1, generator=generator).expand(-1, -1, 96, 96)
    actions = torch.randint(-1, 2, (3, CHUNK, 3), generator=generator).float()
    exist = torch.ones(3, CHUNK, dtype=torch.bool)
    exist[1, 2:] = False  # and yet they are learned
    return Chunks(images, actions, exist, ~exist, torch.arange(3) % len(TASKS))


def test_the_schedule_is_the_published_cosine_up_to_its_last_levels():
    """Nichol and Dhariwal, equation 17: f(t) / f(0) with s = 0.008, betas at most 0.999."""
    alphas = cosine_schedule(100).double().numpy()
    times = np.arange(1, 101) / 100
    f = np.cos((times + 0.008) / 1.008 * math.pi / 2) ** 2
    np.testing.assert_allclose(alphas[:-1], (f / math.cos(0.008 / 1.008 * math.pi / 2) ** 2)[:-1],
                               rtol=1e-4)  # fmt: skip
    assert 0.0 < alphas[-1] < 1e-5


class KnownActions(nn.Module):
    """A denoiser that is asked for known actions."""

    def __init__(self, actions):
        super().__init__()
        self.actions, self.levels = actions, list[int]()

    def forward(self, noisy, levels, features):
        self.levels.append(int(levels[0]))
        self.seen = noisy, levels
        return self.actions


def test_steps_between_follow_the_deterministic_sampler():
    """DDIM with eta = 0, as in equation 12 of Song et al., step by step."""
    network, samples = (
        diffusion.make_policy(diffusion_config(denoising_steps=3)).eval(),
        diffusion_batch(),
    )
    noise = torch.randn(3, CHUNK, 3, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found, noisy = network(samples.images, samples.tasks, noise), noise
        features = network.features(samples.images, samples.tasks)
        for level, following in ((99, 50), (50, 0), (0, None)):
            actions = network.denoiser(noisy, torch.full((3,), level), features).clamp(-1, 1)
            if following is not None:
                alpha, next_alpha = network.alphas[level], network.alphas[following]
                direction = (noisy - alpha**0.5 * actions) / (1 - alpha) ** 0.5
                noisy = next_alpha**0.5 * actions + (1 - next_alpha) ** 0.5 * direction
    torch.testing.assert_close(found, actions)


def test_training_adds_noise_of_all_levels_and_keeps_the_variance():
    network = diffusion.make_policy(diffusion_config())
    network.trunk = _Brightness()
    many = Chunks(*(each.repeat_interleave(300, dim=0) for each in diffusion_batch()))
    network.denoiser = counting = KnownActions(many.actions + 0.5)
    torch.manual_seed(0)
    assert diffusion_losses(network, many)["loss"].item() == pytest.approx(0.25)
    noisy, levels = counting.seen
    assert set(levels.tolist()) == set(range(NOISE_LEVELS))
    alphas = network.alphas[levels, None, None]
    noise = (noisy - alphas.sqrt() * many.actions) / (1.0 - alphas).sqrt()
    assert noise.mean().item() == pytest.approx(0.0, abs=0.03)
    assert noise.std().item() == pytest.approx(1.0, abs=0.03)


class _Brightness(nn.Module):
    """Features of images that take no time."""

    def forward(self, images):
        return images[:, :, 0, 0].repeat(1, 22)[:, :256] * 4 - 2


WINDOW = 4
ID = "magical/MoveToCorner-Demo-v0"


def memory_config(**settings):
    made = {"tasks": TASKS, "demos": "", "window": WINDOW, "augment": "none", **settings}
    return TransformerBCConfig.preset("quick", **made)


def logits(network, tokens, before, exist, tasks=(0, 0)):
    with torch.no_grad():
        return network.logits(tokens, before, exist, torch.tensor(tasks[: len(tokens)]))


@pytest.fixture
def inputs():
    """Two windows: whole, and with two steps before the start."""
    generator = torch.Generator().manual_seed(0)
    tokens = torch.randn(2, WINDOW, WIDTH, generator=generator)
    before = torch.randint(18, (2, WINDOW), generator=generator)
    exist = torch.tensor([[True] * WINDOW, [False, False, True, True]])
    return tokens, before, exist


def test_windows_end_at_samples_and_begin_at_the_demonstrations():
    actions = {"MoveToCorner": [3, 0, 4, 5, 9, 6], "MoveToRegion": [7, 8, 10, 0, 11]}
    pairs = [(task, picture_demo(task, 0, actions[task])) for task in TASKS]
    data = ExpertData(pairs, TASKS, PRESETS["LoRes4E"], remove_noops=True)
    batch = sample_windows(memory_config(batch_size=64), data, np.random.default_rng(3))
    lengths = set()
    for row, task in enumerate(batch.tasks.tolist()):
        shown = [int(image[-1, 0, 0] * 255) // 14 for image in batch.images[row]]
        kept = [action for action in actions[TASKS[task]] if action]
        until = kept[: kept.index(shown[-1]) + 1][-WINDOW:]
        missing = WINDOW - len(until)
        assert batch.exist[row].tolist() == [step >= missing for step in range(WINDOW)]
        assert shown[missing:] == until  # the brightness tells the action
        assert batch.actions[row].tolist()[missing:] == until
        earlier = [NOOP, *kept][kept.index(until[0]) :][: len(until)]
        assert batch.before[row].tolist()[missing:] == earlier
        lengths.add(len(until))
    assert lengths == {1, 2, 3, 4}


def test_the_actions_before_are_those_that_were_executed():
    trajectory = replace(
        picture_demo("MoveToCorner", 0, [3, 9, 5]), expert_actions=np.array([3, 4, 5])
    )
    data = ExpertData([("MoveToCorner", trajectory)], TASKS[:1], PRESETS["LoRes4E"])
    batch = sample_windows(
        memory_config(tasks=TASKS[:1], batch_size=16), data, np.random.default_rng(0)
    )
    (last,) = np.flatnonzero(batch.actions[:, -1] == 5)[:1]
    assert batch.actions[last, -3:].tolist() == [3, 4, 5]
    assert batch.before[last, -3:].tolist() == [NOOP, 3, 9]
    assert batch.exist[last, -3:].all()


@pytest.mark.parametrize("training", [False, True])
def test_steps_see_earlier_ones_that_exist_and_no_others(training, inputs):
    """In training mode, too, whose attention is computed by other code."""
    tokens, before, exist = inputs
    network = transformer_bc.make_policy(memory_config()).train(training)
    for module in network.modules():
        if isinstance(module, torch.nn.Dropout):
            module.p = 0.0
        if isinstance(module, torch.nn.MultiheadAttention):
            module.dropout = 0.0
    plain = logits(network, tokens, before, exist)
    for step in range(WINDOW):
        changed = tokens.clone()
        changed[:, step] *= -1.0
        moved = (logits(network, changed, before, exist) - plain).abs().amax(dim=2) > 1e-5
        assert moved[0].tolist() == [later >= step for later in range(WINDOW)]
        assert moved[1, 2:].tolist() == [exist[1, step].item() and k >= step for k in (2, 3)]
    assert torch.isfinite(plain).all()


def frames_of(count, rows):
    return np.random.default_rng(0).integers(0, 256, (count, rows, 96, 96, 12), np.uint8)


@pytest.mark.parametrize("past_actions", [False, True])
def test_a_policy_computes_what_training_does_on_the_same_window(past_actions):
    made = memory_config(past_actions=past_actions)
    network = transformer_bc.make_policy(made)
    policy = MemoryPolicy(network, made, CPU, greedy=True)
    assert not network.training
    frames, actions = frames_of(7, 1), [NOOP]
    policy.reset(np.ones(1, np.bool_))
    for step in range(len(frames)):
        (action,) = policy.act(frames[step], [ID], np.random.default_rng(0)).tolist()
        steps = range(max(0, step + 1 - WINDOW), step + 1)
        padding = WINDOW - len(steps)
        images = to_unit(torch.from_numpy(frames[list(steps), 0]).permute(0, 3, 1, 2))
        with torch.no_grad():
            tokens = network(images, torch.zeros(len(steps), dtype=torch.int64))
        tokens = torch.cat([torch.zeros(padding, WIDTH), tokens])[None]
        before = torch.tensor([[NOOP] * padding + [actions[k] for k in steps]])
        exist = torch.tensor([[False] * padding + [True] * len(steps)])
        assert logits(network, tokens, before, exist)[0, -1].argmax() == action
        actions.append(action)
    assert len(set(actions)) > 1


ALGORITHMS = ("act", "diffusion", "transformer-bc")


class Recorded:
    """A policy, and the actions that it chose."""

    def __init__(self, policy):
        self.policy, self.observation = policy, policy.observation
        self.actions: list[Any] = []

    def reset(self, mask):
        self.policy.reset(mask)

    def act(self, observations, env_ids, rng):
        self.actions.append(self.policy.act(observations, env_ids, rng).copy())
        return self.actions[-1]


def rolled_out(policy, seeds):
    """The actions (T, B) or (T, B, 3) of episodes that are rolled out together."""
    recorded = Recorded(policy)
    envs = MagicalVectorEnv(
        [EnvId("MoveToRegion", "TestAll")] * len(seeds),
        workers=0,
        observation=policy.observation,
        horizon=6,
        action_space=policy.action_space,
    )
    with closing(envs):
        for _ in play(recorded, envs, seeds):
            pass
    return np.array(recorded.actions)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_rollout_does_not_depend_on_the_others_of_its_batch(algorithm, demos, tmp_path):
    config = tiny(find_algorithm(algorithm).config, demos=str(demos))
    policy = train(config, tmp_path / "run").policy()
    together = rolled_out(policy, [3, 4, 5])
    for row, seed in enumerate([3, 4, 5]):
        np.testing.assert_allclose(together[:, row], rolled_out(policy, [seed])[:, 0], atol=1e-4)
    assert not np.allclose(together[:, 0], together[:, 1])
