"""The site's pages of environments: tasks, scenes and rollouts in words and pictures."""

import io

from PIL import Image

from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.experts import rollout
from magical.tasks import CHANGES, TASKS, Axis, get_task
from tools.site.environments import describe_changes, scoring_rule
from tools.site.previews import SIZE, describe_scene, make_previews


def test_scenes_and_scores_are_the_environments_own() -> None:
    (preview,) = make_previews([EnvId("MoveToRegion", "TestAll")], seed=3, workers=1)
    env = MagicalEnv("MoveToRegion", "TestAll", observation="state")
    env.reset(seed=3)
    assert preview.scene == describe_scene(env.state().scene)
    assert preview.score == rollout("MoveToRegion", "TestAll", 3).score
    with Image.open(io.BytesIO(preview.still)) as still:
        assert still.size == (SIZE, SIZE)
    with Image.open(io.BytesIO(preview.animation)) as animation:
        assert animation.n_frames > 5


def test_scoring_rules_have_formulas_as_blocks() -> None:
    formula = "[q in R] x [T & R not empty] x (1 - |D & R| / |R|)."
    assert f"\n\n```text\n{formula}\n```" in scoring_rule(get_task("FindDupe"))
    assert all(len(scoring_rule(task)) > 60 for task in TASKS.values())


def test_changes_are_the_variants_axes() -> None:
    corner = get_task("MoveToCorner")
    assert describe_changes(corner, "Demo") == "the scene of the demonstrations"
    assert describe_changes(corner, "TestShape") == CHANGES[Axis.SHAPE]
    assert describe_changes(corner, "TestAll") == "jitter, colour, shape, dynamics"


def test_a_scene_in_words() -> None:
    words = "a robot, 2 green goal regions, 1 red goal region, 1 green pentagon, "
    assert describe_scene(get_task("FixColour").demo) == words + "1 green square, 1 blue pentagon"
