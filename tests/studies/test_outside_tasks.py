"""Tasks outside the language of goals: experts reach every goal, idleness none."""

import pytest

from magical.evaluation import evaluate, load_policy
from magical.tasks import get_task, unregister_task
from studies.outside_tasks.tasks import DEVELOPMENT, HELD_BACK


@pytest.fixture(scope="module", autouse=True)
def registered():
    yield
    for name in (*DEVELOPMENT, *HELD_BACK):
        unregister_task(name)


@pytest.mark.parametrize("name", [*DEVELOPMENT, *HELD_BACK])
def test_the_expert_reaches_the_goal_and_idleness_does_not(name):
    assert "TestAll" in get_task(name).variants
    envs = [f"magical/{name}-{variant}-v0" for variant in ("Demo", "TestAll")]
    for policy, expected in (("expert", 1.0), ("noop", 0.0)):
        scores = [each.score for each in evaluate(load_policy(policy), envs, rollouts=4, workers=1)]
        assert sum(scores) / len(scores) == pytest.approx(expected, abs=0.26)
