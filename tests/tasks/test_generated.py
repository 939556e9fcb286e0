"""Generated tasks: reproducible, valid in every variant, distinct in the suite, solvable."""

import gymnasium
import numpy as np
import pytest

import magical
from magical.errors import UnknownNameError
from magical.evaluation import environments, evaluate, load_policy, summarise
from magical.tasks import TASKS, get_task
from magical.tasks.axes import VARIANTS
from magical.tasks.programs import parse, problem
from magical.tasks.programs.generated import generated_task
from magical.tasks.programs.suite import HELD_OUT, LEAST_SCORES, SUITE, TRAINING, task_name

SOME = [task_name(number) for number in SUITE[:8]]


def test_a_number_always_gives_the_same_task() -> None:
    first = get_task(SOME[0])
    generated_task.cache_clear()
    again = get_task(SOME[0])
    assert again is not first
    assert (again.program, again.demo) == (first.program, first.demo)
    assert repr(get_task("Generated0042").program) == ("Lined(AllBut(Nearest('robot')))")


@pytest.mark.parametrize("name", SOME)
def test_every_variant_has_scenes_that_fit_the_program(name: str) -> None:
    task = get_task(name)
    assert task.program is not None
    assert parse(repr(task.program)) == task.program
    assert task.variants == tuple(VARIANTS)
    for variant in VARIANTS:
        scenes = [task.sample(variant, np.random.default_rng(seed))[0] for seed in range(6)]
        assert scenes[0] == task.sample(variant, np.random.default_rng(0))[0]
        assert (len(set(scenes)) > 1) == (variant not in ("Demo", "TestDynamics"))
        for scene in scenes:
            task.validate(scene)
            assert not problem(task.program, scene)


def test_the_suites_programs_are_all_different_and_none_of_the_papers() -> None:
    programs = [get_task(task_name(number)).program for number in SUITE]
    assert len(set(programs) | {task.program for task in TASKS.values()}) == 96 + 8
    assert (len(TRAINING), len(HELD_OUT)) == (64, 32)
    assert not set(TRAINING) & set(HELD_OUT)


def test_environments_of_the_suite_are_made_by_their_ids() -> None:
    env = gymnasium.make(magical.env_spec(f"magical/{task_name(HELD_OUT[0])}-TestAll-LoRes4E-v0"))
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert task_name(HELD_OUT[0]) not in list(TASKS)  # there are too many to iterate over
    with pytest.raises(UnknownNameError, match="version v3 is unknown; expected v0"):
        magical.parse_env_id(f"magical/{task_name(0)}-Demo-v3")
    for number in ("42", "\u0660\u0660\u0664\u0662"):  # digits of another script
        with pytest.raises(UnknownNameError, match=f"'Generated{number}' is not registered"):
            magical.parse_env_id(f"magical/Generated{number}-Demo-v0")


@pytest.mark.parametrize("name", SOME[:2])
def test_the_expert_solves_tasks_of_the_suite(name: str) -> None:
    env_ids = environments([name], LEAST_SCORES)
    scores = evaluate(load_policy("expert"), env_ids, rollouts=4, workers=0, nudge=1e-9)
    for variant, row in summarise(scores).items():
        assert row["mean"] >= LEAST_SCORES[variant] - 0.2
