"""Tasks outside the language of goals: experts reach every goal, idleness none."""

import pytest

from magical.evaluation import evaluate, load_policy
from magical.tasks import get_task

DEVELOPMENT = ("Centre", "Between", "StarsRegion", "LeaveOthers", "StopShort", "ThenCircle")
HELD_BACK = ("Swap", "LeftOf", "SmallerRegion", "Mirror", "Apart", "HalfWay")


def test_six_are_to_develop_on_and_six_are_held_back(outside_tasks):
    assert tuple(outside_tasks.DEVELOPMENT) == DEVELOPMENT
    assert tuple(outside_tasks.HELD_BACK) == HELD_BACK


@pytest.mark.parametrize("name", [*DEVELOPMENT, *HELD_BACK])
@pytest.mark.usefixtures("outside_tasks")
def test_the_expert_reaches_the_goal_and_idleness_does_not(name):
    assert "TestAll" in get_task(name).variants
    envs = [f"magical/{name}-{variant}-v0" for variant in ("Demo", "TestAll")]
    for policy, expected in (("expert", 1.0), ("noop", 0.0)):
        scores = [each.score for each in evaluate(load_policy(policy), envs, rollouts=4, workers=1)]
        assert sum(scores) / len(scores) == pytest.approx(expected, abs=0.26)
