"""Beliefs about goals outside the language are held against what was demonstrated."""

import pytest

from magical.demos.generate import demonstrate
from magical.tasks import unregister_task
from magical_goals.objects.data import parse_demonstrations
from magical_goals.objects.parser import parse_frames
from magical_goals.program_bc import ProgramBCConfig, infer_beliefs
from studies.outside_tasks.tasks import DEVELOPMENT, HELD_BACK


@pytest.fixture(scope="module", autouse=True)
def registered():
    yield
    for name in (*DEVELOPMENT, *HELD_BACK):
        unregister_task(name)


@pytest.mark.parametrize(
    ("task", "contradiction"),
    [("StarsRegion", "end elsewhere"), ("ThenCircle", "driven at the end"), ("MatchRegions", "")],
)
def test_a_goal_that_fits_but_would_not_be_acted_on_alike_is_no_explanation(task, contradiction):
    shown = [(task, demonstrate(f"magical/{task}-Demo-v0", seed=seed)) for seed in range(4)]
    parsed = parse_demonstrations(tuple(shown), parse_frames)
    belief = infer_beliefs(ProgramBCConfig(tasks=(task,), demos="unused"), parsed)[task]
    assert contradiction in belief.contradiction
    assert belief.is_explained is not bool(contradiction)
    assert belief.contradiction in belief.verdict
    assert len(belief.ends) >= 4
