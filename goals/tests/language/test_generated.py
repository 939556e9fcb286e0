"""Generated tasks: reproducible, valid in every variant, distinct in the suite, solvable."""

import hashlib
import json

import gymnasium
import numpy as np
import pytest

import magical
from magical.errors import UnknownNameError
from magical.evaluation import environments, evaluate, load_policy, summarise
from magical.tasks import TASKS, get_task, suites
from magical.tasks.axes import VARIANTS
from magical_goals.language import generated, parse, problem
from magical_goals.language.generated import HELD_OUT, SUITE, TRAINING, task_name
from magical_goals.language.programs import PROGRAMS, program_of

SOME = [task_name(number) for number in SUITE[:8]]
LEAST_SCORES = {"Demo": 0.9, "All": 0.8}  # as in studies/generated_tasks


def test_a_number_always_gives_the_same_task():
    first = get_task(SOME[0])
    generated.generate.cache_clear()
    again = get_task(SOME[0])
    assert again is not first
    assert (again.summary, again.demo) == (first.summary, first.demo)
    assert repr(program_of("Generated0042")) == "Lined(AllBut(Nearest('robot')))"


def test_a_number_stands_for_the_same_scenes_in_all_versions():
    """Otherwise scores of earlier versions are of other tasks."""
    digest = hashlib.sha256()
    for name in SOME:
        for variant in VARIANTS:
            scene, dynamics = get_task(name).sample(variant, np.random.default_rng(0))
            start = json.dumps([scene.to_dict(), dynamics.to_dict()])
            rounded = json.loads(start, parse_float=lambda text: round(1e6 * float(text)))
            digest.update(json.dumps(rounded).encode())
    assert digest.hexdigest()[:12] == "5999d5055a3e"


@pytest.mark.parametrize("name", SOME)
def test_every_variant_has_scenes_that_fit_the_program(name):
    task, program = get_task(name), program_of(name)
    assert parse(repr(program)) == program
    assert task.variants == tuple(VARIANTS)
    for variant in VARIANTS:
        scenes = [task.sample(variant, np.random.default_rng(seed))[0] for seed in range(6)]
        assert scenes[0] == task.sample(variant, np.random.default_rng(0))[0]
        assert (len(set(scenes)) > 1) == (variant not in ("Demo", "TestDynamics"))
        for scene in scenes:
            task.validate(scene)
            assert not problem(program, scene)


def test_the_suites_programs_are_all_different_and_none_of_the_papers():
    programs = [program_of(task_name(number)) for number in SUITE]
    assert len({*programs, *PROGRAMS.values()}) == 96 + 8
    assert suites() == {"Held-out tasks": HELD_OUT, "Training tasks": TRAINING}
    assert (len(TRAINING), len(HELD_OUT)) == (64, 32)
    assert not set(TRAINING) & set(HELD_OUT)


def test_environments_of_the_suite_are_made_by_their_ids():
    env = gymnasium.make(magical.env_spec(f"magical/{HELD_OUT[0]}-TestAll-LoRes4E-v0"))
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert HELD_OUT[0] not in list(TASKS)  # there are too many to iterate over
    with pytest.raises(UnknownNameError, match=r"Demo-v3.: expected magical/"):
        magical.parse_env_id(f"magical/{task_name(0)}-Demo-v3")
    for number in ("42", "\u0660\u0660\u0664\u0662"):  # digits of another script
        with pytest.raises(UnknownNameError, match=f"'Generated{number}' is not registered"):
            magical.parse_env_id(f"magical/Generated{number}-Demo-v0")


@pytest.mark.parametrize("name", SOME[:2])
def test_the_expert_solves_tasks_of_the_suite(name):
    env_ids = environments([name], LEAST_SCORES)
    scores = evaluate(load_policy("expert"), env_ids, rollouts=4, workers=0, nudge=1e-9)
    for variant, row in summarise(scores).items():
        assert row["mean"] >= LEAST_SCORES[variant] - 0.2
