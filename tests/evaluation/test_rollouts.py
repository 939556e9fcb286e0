"""Rollouts: fixed seeds, all variants side by side, results that depend on nothing else."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

from magical.envs import EnvId, parse_env_id
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError, PolicyError, UnknownNameError
from magical.evaluation import (
    Evaluation,
    NoopPolicy,
    RandomPolicy,
    environments,
    evaluate,
    load_policy,
)
from magical.evaluation.expert import ExpertPolicy
from magical.evaluation.policy import Actions, Mask
from magical.evaluation.rollouts import RepeatedEvaluation
from magical.evaluation.seeds import rollout_stream
from magical.scene import State
from magical.tasks import TASKS

DEMO = "magical/MoveToRegion-Demo-v0"
LAYOUT = "magical/MoveToRegion-TestLayout-v0"
ALL = "magical/MoveToRegion-TestAll-v0"


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


@pytest.mark.parametrize(
    ("tasks", "variants", "message"),
    [
        (["MoveToRegoin"], None, "MoveToRegion"),
        (None, ["Color"], "Colour"),
        (["MoveToRegion"], ["Shape"], "MoveToRegion has none of the variants TestShape"),
    ],
)
def test_environments_by_names(tasks: Any, variants: Any, message: str) -> None:
    assert len(environments()) == sum(len(task.variants) for task in TASKS.values())
    assert environments(["MoveToRegion"], ["Jitter", "Demo"]) == [
        "magical/MoveToRegion-Demo-v0",
        "magical/MoveToRegion-TestJitter-v0",
    ]
    having = [env_id.task for env_id in environments(variants="Shape")]
    assert having == [name for name, task in TASKS.items() if "TestShape" in task.variants]
    with pytest.raises(UnknownNameError, match=message):
        environments(tasks, variants)


def test_every_rollout_equals_an_episode_of_the_single_environment() -> None:
    scores = evaluate(load_policy("random"), [ALL], rollouts=30, workers=0)
    assert [row.rollout for row in scores] == list(range(30))
    assert any(row.score for row in scores)
    for row in scores:
        env = gymnasium.make(row.env_id, observation="state")
        env.reset(seed=evaluation_seed(row.rollout))
        rng = np.random.Generator(np.random.PCG64(rollout_stream(row.env_id, row.seed)))
        truncated = False
        while not truncated:
            _, _, _, truncated, info = env.step(int(rng.integers(18)))
        assert row.score == info["eval_score"]
        assert row.published_code_score == info["published_code_score"]


@pytest.mark.parametrize("options", [{"num_envs": 1}, {"num_envs": 5}, {"workers": 2}])
def test_results_do_not_depend_on_batch_workers_or_company(options: dict[str, Any]) -> None:
    alone = evaluate(RandomPolicy(), [LAYOUT], rollouts=9, workers=0)
    together = evaluate(RandomPolicy(), [DEMO, LAYOUT], rollouts=9, **({"workers": 0} | options))
    assert [row for row in together if row.env_id == LAYOUT] == alone


def test_a_repeated_evaluation_gives_the_same_scores_in_the_same_environments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []

    def recorded(*arguments: Any, **options: Any) -> MagicalVectorEnv:
        made.append(MagicalVectorEnv(*arguments, **options))
        return made[-1]

    ids = [parse_env_id(DEMO), parse_env_id("magical/MoveToCorner-TestJitter-v0")]
    expected = evaluate(RandomPolicy(), ids, rollouts=3, seed=1, workers=0)
    monkeypatch.setattr("magical.evaluation.rollouts.MagicalVectorEnv", recorded)
    evaluation = RepeatedEvaluation(RandomPolicy(), Evaluation.of(ids, rollouts=3, seed=1), 0)
    assert evaluation.scores() == expected
    assert evaluation.scores() == expected
    assert len(made) == 2  # one for each task
    evaluation.close()
    assert all(env.closed for env in made)


def test_rows_come_by_environment_then_rollout_and_tasks_may_mix() -> None:
    ids = [LAYOUT, "magical/FixColour-Demo-v0", DEMO]
    twice = [*ids, DEMO]  # which counts once
    seen: list[int] = []
    scores = evaluate(
        NoopPolicy(), twice, rollouts=5, horizon=1, num_envs=6, workers=0, progress=seen.append
    )
    assert [(row.env_id, row.rollout) for row in scores] == [(i, n) for i in ids for n in range(5)]
    assert sum(seen) == 15
    others = evaluate(NoopPolicy(), ids, rollouts=5, horizon=1, seed=1, workers=0)
    assert not {row.seed for row in scores} & {row.seed for row in others}


def test_policies_see_the_observation_they_were_made_for_and_are_told_of_episodes() -> None:
    policy = Watching(observation="LoRes4A", tasks=("MoveToRegion",))
    scores = evaluate(policy, rollouts=3, num_envs=12, horizon=2, workers=0)
    variants = len(TASKS["MoveToRegion"].variants)
    assert len(scores) == 3 * variants
    assert [len(mask) for mask in policy.resets] == [2 * variants] * 2  # two waves
    assert all(mask.all() for mask in policy.resets)
    observations, env_ids = policy.acts[0]
    assert observations.shape == (2 * variants, 96, 96, 12)
    assert env_ids[0] == "magical/MoveToRegion-Demo-v0"


@pytest.mark.parametrize(
    ("own", "asked_for", "shape"),
    [
        (None, None, (1, 96, 96, 12)),
        ("LoRes4A", None, (1, 96, 96, 12)),
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


def test_privileged_policies_see_states() -> None:
    policy = Watching(privileged=True)
    evaluate(policy, [DEMO], rollouts=2, horizon=2, workers=0)
    assert all(isinstance(state, State) for state in policy.acts[1][0])
    assert [state.step for state in policy.acts[1][0]] == [1, 1]


@pytest.mark.parametrize(
    ("env_ids", "horizon", "steps"),
    [
        (["magical/ClusterColour-Demo-v0"], None, 320),
        (["magical/ClusterColour-Demo-v0"], 7, 7),
        # The published horizon is for tasks that have one of their own; the others keep theirs.
        ([DEMO, "magical/ClusterShape-Demo-v0"], "published", 40 + 240),
    ],
)
def test_horizons(env_ids: list[str], horizon: Any, steps: int) -> None:
    policy = Watching(observation="state")
    evaluate(policy, env_ids, rollouts=1, horizon=horizon, workers=0)
    assert len(policy.acts) == steps


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        *(
            ({"horizon": horizon}, InvalidConfigError, "expected appendix, published or a number")
            for horizon in ("long", 0, -3)
        ),
        ({"horizon": "published"}, UnknownNameError, "ClusterShape.*found.*MoveToRegion"),
        ({"observation": "HiRes"}, UnknownNameError, "LoRes4E"),
        ({"policy": "noop", "observation": "HiRes"}, UnknownNameError, "LoRes4E"),
        (
            {"policy": Watching(observation="LoRes4A"), "observation": "LoRes4E"},
            PolicyError,
            "its own",
        ),
        ({"env_ids": []}, ValueError, "at least one environment, found none"),
        ({"env_ids": [f"{DEMO[:-3]}-LoRes4A-v0"]}, ValueError, "set by observation='LoRes4A'"),
        ({"rollouts": 0}, ValueError, "at least 1, found 0"),
        ({"nudge": 1.0}, ValueError, "noise: expected"),
        ({"seed": -1}, ValueError, "seed: expected at least 0, found -1"),
        ({"workers": -1}, ValueError, "workers: expected at least 0, or None, found -1"),
    ],
)
def test_wrong_settings_are_named(
    settings: dict[str, Any], error: type[Exception], message: str
) -> None:
    given: dict[str, Any] = {"policy": Watching(), "env_ids": [DEMO], "rollouts": 1, "workers": 0}
    with pytest.raises(error, match=message):
        evaluate(**(given | settings))


def test_one_name_may_be_given_as_it_is() -> None:
    assert environments("MoveToRegion", "Demo") == environments(["MoveToRegion"], ["Demo"])
    assert len(evaluate("noop", DEMO, rollouts=1, horizon=2, workers=0)) == 1


def test_an_expert_runs_in_no_negative_number_of_processes() -> None:
    with pytest.raises(ValueError, match="workers: expected at least 0"):
        evaluate("expert", DEMO, rollouts=1, workers=-1)


class Continuous:
    action_space = "continuous"

    def act(
        self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator
    ) -> NDArray[np.float32]:
        return np.zeros((len(env_ids), 3), np.float32)


def test_a_policy_may_return_any_numbers_and_needs_no_reset() -> None:
    assert len(evaluate(Continuous(), DEMO, rollouts=1, horizon=2, workers=0)) == 1  # and mypy


@pytest.mark.parametrize("horizon", [None, 320, "320", "appendix"])
def test_the_appendix_s_steps_are_the_appendix_s_horizon(horizon: Any) -> None:
    env_ids = [EnvId("ClusterColour", "Demo")]
    assert Evaluation.of(env_ids, horizon=horizon).horizon_name == "appendix"
    assert Evaluation.of([*env_ids, DEMO], horizon=320).horizon_name == "320"
    assert Evaluation.of(env_ids, horizon=240).horizon_name == "240"
    assert Evaluation.of([*env_ids, DEMO], horizon="published").horizon_name == "published"


class Reacting:
    """Acts by what it observes; with `edits` it overwrites its observations afterwards."""

    tasks = ("MoveToRegion",)

    def __init__(self, observation: str, privileged: bool, edits: bool) -> None:
        self.observation = observation
        self.privileged = privileged
        self.edits = edits

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        arrays = self._arrays(observations)
        sums = sum(np.abs(array).reshape(len(env_ids), -1).sum(axis=1) for array in arrays)
        if self.edits:
            for array in arrays:
                array[...] = 7
        return (1000 * np.asarray(sums)).astype(np.int64) % 18

    def reset(self, mask: Mask) -> None:
        pass

    def _arrays(self, observations: Any) -> list[Any]:
        if self.privileged:
            base = observations[0].poses.bodies.base
            assert base is not None
            return [base, observations[0].velocities.base]
        return list(observations.values()) if isinstance(observations, dict) else [observations]


@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.parametrize(
    "observation", ["LoRes4E", "LoRes3EA", "LoResStack", "state", "true state"]
)
def test_a_policy_that_edits_its_observations_changes_nothing(
    observation: str, workers: int
) -> None:
    privileged = observation == "true state"
    results = [
        evaluate(
            Reacting("state" if privileged else observation, privileged, edits),
            [DEMO],
            rollouts=2,
            horizon=6,
            workers=workers,
        )
        for edits in (False, True)
    ]
    assert results[0] == results[1]


def test_a_nudge_gives_every_rollout_its_own_start() -> None:
    exact, nudged = Watching(privileged=True), Watching(privileged=True)
    evaluate(exact, [DEMO], rollouts=3, horizon=1, workers=0)
    scores = evaluate(nudged, [DEMO], rollouts=3, horizon=1, nudge=1e-9, workers=0)
    same, starts = (
        np.stack([state.poses.bodies for state in policy.acts[0][0]]) for policy in (exact, nudged)
    )  # (3, 5, 3) each
    assert np.array_equal(same[0], same[1])
    assert len(np.unique(starts[:, 0, 0])) == 3
    assert 0 < np.abs(starts - same).max() < 1e-8
    assert [row.seed for row in scores] == [evaluation_seed(i) for i in range(3)]


@pytest.mark.parametrize("name", ["random", "expert"])
def test_a_nudge_does_not_depend_on_processes(name: str) -> None:
    policy = load_policy(name)
    one = evaluate(policy, [DEMO], rollouts=12, nudge=1e-9, workers=0)
    assert evaluate(policy, [DEMO], rollouts=12, nudge=1e-9, workers=2) == one


class Drives:
    """Drives at half speed in continuous environments."""

    action_space = "continuous"
    observation = "nothing"

    def __init__(self, speed: float = 0.5) -> None:
        self.speed = speed

    def act(self, observations: Any, env_ids: Sequence[EnvId], rng: np.random.Generator) -> Actions:
        return np.tile([self.speed, 0.0, -1.0], (len(env_ids), 1))

    def reset(self, mask: Mask) -> None:
        pass


def test_policies_with_continuous_actions_are_evaluated_in_such_environments() -> None:
    env_id = "magical/MoveToRegion-TestJitter-v0"
    (score,) = evaluate(Drives(), [env_id], rollouts=1, workers=0)
    env = gymnasium.make(env_id, observation="state", action_space="continuous")
    env.reset(seed=evaluation_seed(0))
    ended = False
    while not ended:
        *_, ended, info = env.step(np.array([0.5, 0.0, -1.0]))
    assert score.score == info["eval_score"]


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (Drives(np.nan), "found drive nan in row 0"),
        (Drives(1.5), "found drive 1.5 in row 0"),
        (
            lambda observations, env_ids, rng: np.zeros((len(env_ids), 3)),
            r"expected integers from 0 to 17 of shape \(1,\), found <array of shape",
        ),
    ],
)
def test_other_continuous_actions_are_named(policy: Any, message: str) -> None:
    with pytest.raises(PolicyError, match=message):
        evaluate(policy, ["magical/MoveToRegion-Demo-v0"], rollouts=1, workers=0)


def test_an_unknown_action_space_is_named() -> None:
    policy = Drives()
    policy.action_space = "box"
    with pytest.raises(UnknownNameError, match="expected discrete or continuous"):
        evaluate(policy, ["magical/MoveToRegion-Demo-v0"], rollouts=1, workers=0)


@pytest.mark.parametrize("workers", [0, 2])
def test_the_expert_scores_the_same_with_points(workers: int) -> None:
    env_ids = ["magical/MoveToCorner-TestJitter-v0"]
    policies = [ExpertPolicy(0.3, action_space=name) for name in ("discrete", "continuous")]
    first, second = (evaluate(p, env_ids, rollouts=3, workers=workers) for p in policies)
    assert first == second
