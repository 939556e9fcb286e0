"""Rollouts: fixed seeds, noise, random streams, results that depend on nothing else."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.envs.seeds import evaluation_seed
from magical.errors import InvalidConfigError, PolicyError, UnknownNameError
from magical.evaluation import Evaluation, NoopPolicy, environments, evaluate
from magical.evaluation.policy import Actions, Mask
from magical.evaluation.protocol import MAX_NOISE, noisy_start
from magical.evaluation.rollouts import ROW_METHODS, RolloutRng, rollout_stream
from magical.scene import State
from magical.tasks import TASKS

DEMO = "magical/MoveToRegion-Demo-v0"
LAYOUT = "magical/MoveToRegion-TestLayout-v0"
NOISE = 1e-9


class Watching:
    """Keeps the arguments of every call."""

    def __init__(self, **attributes: Any) -> None:
        self.acts: list[tuple[Any, tuple[str, ...]]] = []
        self.resets: list[Mask] = []
        self.__dict__.update(attributes)

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        self.acts.append((observations, tuple(env_ids)))
        return np.zeros(len(env_ids), np.int64)

    def reset(self, mask: Mask) -> None:
        self.resets.append(mask.copy())


def test_environments_by_names() -> None:
    assert len(environments()) == sum(len(task.variants) for task in TASKS.values())
    assert environments("MoveToRegion", ["Layout", "Demo"]) == [DEMO, LAYOUT]
    having = [env_id.task for env_id in environments(variants="Shape")]
    assert having == [name for name, task in TASKS.items() if "TestShape" in task.variants]
    with pytest.raises(UnknownNameError, match="MoveToRegion has none of the variants TestShape"):
        environments("MoveToRegion", "Shape")


def test_every_rollout_equals_an_episode_of_the_single_environment() -> None:
    scores = evaluate("random", "magical/MoveToRegion-TestAll-v0", rollouts=20, workers=0)
    assert [row.rollout for row in scores] == list(range(20))
    assert any(row.score for row in scores)
    env = gymnasium.make(scores[0].env_id, observation="state")
    for row in scores:
        env.reset(seed=evaluation_seed(row.rollout))
        rng = np.random.Generator(np.random.PCG64(rollout_stream(row.env_id, row.seed)))
        truncated = False
        while not truncated:
            _, _, _, truncated, info = env.step(int(rng.integers(18)))
        assert row.score == info["eval_score"]
        assert row.published_code_score == info["published_code_score"]


@pytest.mark.parametrize(("policy", "workers"), [("random", 0), ("random", 2), ("expert", 2)])
def test_results_do_not_depend_on_batch_workers_or_company(policy: str, workers: int) -> None:
    given: dict[str, Any] = {"rollouts": 40, "horizon": 10, "nudge": NOISE}
    alone = evaluate(policy, [LAYOUT], workers=0, **given)
    together = evaluate(policy, [DEMO, LAYOUT], workers=workers, **given)  # in several rounds
    assert [row for row in together if row.env_id == LAYOUT] == alone


def test_rows_come_by_environment_then_rollout_and_tasks_may_mix() -> None:
    ids = [LAYOUT, "magical/FixColour-Demo-v0", DEMO]
    seen: list[int] = []
    given: dict[str, Any] = {"rollouts": 5, "horizon": 1, "workers": 0}
    scores = evaluate(NoopPolicy(), [*ids, DEMO], **given, progress=seen.append)  # counts once
    assert [(row.env_id, row.rollout) for row in scores] == [(i, n) for i in ids for n in range(5)]
    assert sum(seen) == 15
    others = evaluate(NoopPolicy(), ids, seed=1, **given)
    assert not {row.seed for row in scores} & {row.seed for row in others}


def test_policies_are_evaluated_on_their_tasks_in_rounds_and_told_of_episodes() -> None:
    policy = Watching(observation="LoRes4A", tasks=("MoveToRegion",))
    variants = len(TASKS["MoveToRegion"].variants)
    assert len(evaluate(policy, rollouts=12, horizon=2, workers=0)) == 12 * variants
    assert [len(mask) for mask in policy.resets] == [6 * variants] * 2  # of at most 64
    assert all(mask.all() for mask in policy.resets)
    observations, env_ids = policy.acts[0]
    assert observations.shape == (6 * variants, 96, 96, 12)
    assert env_ids[0] == "magical/MoveToRegion-Demo-v0"


@pytest.mark.parametrize(
    ("own", "asked_for", "shape"),
    [
        (None, None, (1, 96, 96, 12)),
        ("LoRes4A", "LoRes4A", (1, 96, 96, 12)),
        (None, "LoResCHW4E", (1, 12, 96, 96)),
        ("nothing", "LoRes4A", None),
    ],
)
def test_policies_see_what_was_asked_for_else_their_own_else_LoRes4E(
    own: str | None, asked_for: str | None, shape: tuple[int, ...] | None
) -> None:
    policy = Watching(observation=own)
    evaluate(policy, [DEMO], rollouts=1, horizon=1, observation=asked_for, workers=0)
    assert getattr(policy.acts[0][0], "shape", None) == shape


@pytest.mark.parametrize(
    ("env_ids", "horizon", "steps", "name"),
    [
        (["magical/ClusterColour-Demo-v0"], None, 320, "appendix"),
        (["magical/ClusterColour-Demo-v0"], "320", 320, "appendix"),
        (["magical/ClusterColour-Demo-v0"], 7, 7, "7"),
        # The published horizon is for tasks that have one of their own; the others keep theirs.
        ([DEMO, "magical/ClusterShape-Demo-v0"], "published", 40 + 240, "published"),
    ],
)
def test_horizons(env_ids: list[str], horizon: Any, steps: int, name: str) -> None:
    policy = Watching(observation="state")
    evaluate(policy, env_ids, rollouts=1, horizon=horizon, workers=0)
    assert len(policy.acts) == steps
    assert Evaluation.of(env_ids, horizon=horizon).horizon_name == name


def other_actions(**attributes: Any) -> Any:
    def act(observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Any:
        return np.tile(attributes["action"], (len(env_ids), 1))

    return Watching(**(attributes | {"act": act}))


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"horizon": "long"}, InvalidConfigError, "expected appendix, published or a number"),
        ({"horizon": "published"}, UnknownNameError, "one horizon only: MoveToRegion"),
        ({"policy": "noop", "observation": "HiRes"}, UnknownNameError, "LoRes4E"),
        (
            {"policy": Watching(observation="LoRes4A"), "observation": "LoRes4E"},
            PolicyError,
            "its own",
        ),
        ({"env_ids": []}, ValueError, "at least one environment, found none"),
        ({"env_ids": [f"{DEMO[:-3]}-LoRes4A-v0"]}, ValueError, "set by observation='LoRes4A'"),
        ({"rollouts": 0}, ValueError, "at least 1, found 0"),
        ({"nudge": 2 * MAX_NOISE}, InvalidConfigError, "noise: expected a number from 0 to"),
        ({"nudge": np.nan}, InvalidConfigError, "noise: expected a number from 0 to"),
        ({"seed": -1}, ValueError, "seed: expected at least 0, found -1"),
        ({"workers": -1}, ValueError, "workers: expected at least 0, or None, found -1"),
        ({"policy": other_actions(action=[0.0])}, PolicyError, r"integers from 0 to 17 of shape"),
        ({"policy": other_actions(action_space="box")}, UnknownNameError, "discrete or continuous"),
        (
            {"policy": other_actions(action_space="continuous", action=[1.5, 0.0, 0.0])},
            PolicyError,
            "found drive 1.5 in row 0",
        ),
    ],
)
def test_wrong_settings_and_actions_are_named(
    given: dict[str, Any], error: type[Exception], message: str
) -> None:
    usual: dict[str, Any] = {"policy": Watching(), "env_ids": [DEMO], "rollouts": 1, "workers": 0}
    with pytest.raises(error, match=message):
        evaluate(**(usual | given))


def test_policies_with_continuous_actions_are_evaluated_in_such_environments() -> None:
    drive = [0.5, 0.0, -1.0]
    policy = other_actions(action_space="continuous", observation="nothing", action=drive)
    (score,) = evaluate(policy, [LAYOUT], rollouts=1, workers=0)
    env = gymnasium.make(LAYOUT, observation="state", action_space="continuous")
    env.reset(seed=evaluation_seed(0))
    ended = False
    while not ended:
        *_, ended, info = env.step(np.array(drive))
    assert score.score == info["eval_score"]


def test_privileged_policies_see_states_which_noise_moves() -> None:
    exact, moved = Watching(privileged=True), Watching(privileged=True)
    evaluate(exact, [DEMO], rollouts=3, horizon=2, workers=0)
    scores = evaluate(moved, [DEMO], rollouts=3, horizon=2, nudge=NOISE, workers=0)
    assert all(isinstance(state, State) for state in exact.acts[1][0])
    assert [state.step for state in exact.acts[1][0]] == [1, 1, 1]
    same, starts = (
        np.stack([state.poses.bodies for state in policy.acts[0][0]]) for policy in (exact, moved)
    )  # (3, 5, 3) each
    assert np.array_equal(same[0], same[1])
    assert len(np.unique(starts[:, 0, 0])) == 3
    assert 0 < np.abs(starts - same).max() < 1e-8
    assert [row.seed for row in scores] == [evaluation_seed(i) for i in range(3)]


@pytest.mark.parametrize("task", TASKS)
def test_noise_moves_robot_and_blocks_and_cannot_be_seen(task: str) -> None:
    env = MagicalEnv(task, "TestAll" if task == "MoveToCorner" else "Demo", observation="LoRes4E")
    exact_frames, _ = env.reset(seed=0)
    exact, sampled = env.state().poses.bodies, env.simulation.dynamics
    env_id = EnvId(task, env.variant)
    scene, dynamics = noisy_start(env_id, 0, NOISE)
    assert dynamics == sampled
    assert (scene, dynamics) == noisy_start(env_id, 0, NOISE)
    frames, _ = env.reset(seed=0, options={"scene": scene, "dynamics": dynamics})
    moved = np.r_[0, 5 : len(exact)]  # the robot and the blocks
    shift = np.abs(env.state().poses.bodies - exact)[moved]
    assert 0 < shift.min() <= shift.max() <= NOISE * 1.001
    assert np.array_equal(frames, exact_frames)


@pytest.mark.parametrize(
    "env_id", [EnvId("ClusterShape", "TestShape"), EnvId("ClusterColour", "Demo")]
)
def test_scenes_that_touch_still_fit_with_the_most_noise(env_id: EnvId) -> None:
    """The poses of ClusterShape's Demo reach into a wall, and ClusterColour's overlap."""
    for seed in range(20):
        noisy_start(env_id, seed, MAX_NOISE)


def test_seeds_and_streams_are_the_same_in_all_versions() -> None:
    assert [evaluation_seed(i) for i in range(3)] == [1_000_000_000, 1_000_000_001, 1_000_000_002]
    assert evaluation_seed(3, seed=2) == 1_002_000_003
    assert rollout_stream("magical/FindDupe-Demo-v0", 7) == (7, 2_007_158_634)
    assert rollout_stream("magical/FindDupe-TestAll-v0", 7) == (7, 1_583_955_812)


@pytest.mark.parametrize("name", ROW_METHODS)
@pytest.mark.parametrize("rest", [(), (18,)])
def test_a_row_samples_the_same_in_any_batch(name: str, rest: tuple[int, ...]) -> None:
    parameters = (2**40,) if name == "integers" else ()
    large, small = RolloutRng("abab", [5, 6, 7, 8]), RolloutRng("ab", [7, 4])
    for _ in range(3):
        many = getattr(large, name)(*parameters, size=(4, *rest))
        few = getattr(small, name)(*parameters, size=(2, *rest))
        assert many.shape == (4, *rest)
        np.testing.assert_array_equal(many[2], few[0])
        assert not np.array_equal(many[0], many[1])


def test_sizes_may_be_plain_numbers_and_positional() -> None:
    first, second = RolloutRng("ab", [1, 2]), RolloutRng("ab", [1, 2])
    np.testing.assert_array_equal(first.integers(0, 18, 2), second.integers(18, size=(2,)))
    one, other = RolloutRng("ab", [1, 1]).random((2, 5))  # environments share no stream
    assert not set(one) & set(other)


@pytest.mark.parametrize(
    "sample",
    [
        lambda rng: rng.random(),
        lambda rng: rng.normal(np.zeros(2), size=2),
        lambda rng: rng.random(2, out=np.empty(2)),
        lambda rng: rng.choice(18, size=2),
    ],
)
def test_other_samples_come_from_the_common_stream(sample: Any) -> None:
    words = [*rollout_stream("a", 1), *rollout_stream("b", 2)]
    common = np.random.Generator(np.random.PCG64(words))
    np.testing.assert_array_equal(sample(RolloutRng("ab", [1, 2])), sample(common))
