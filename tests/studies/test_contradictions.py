"""Beliefs about goals outside the language are held against what was demonstrated."""

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.tests import tiny_runs
from magical.demos.generate import demonstrate, generate
from magical.evaluation.rollouts import RolloutRng
from magical_baselines import load_policy, train
from magical_goals.objects.data import parse_demonstrations
from magical_goals.objects.parser import parse_frames
from magical_goals.program_bc import ProgramBCConfig, infer_beliefs

pytestmark = pytest.mark.usefixtures("outside_tasks")


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


def test_what_no_program_explains_is_cloned_from_pixels(tmp_path: Path):
    generate("magical/StarsRegion-Demo-v0", 4, tmp_path / "demos", min_score=1.0)
    fields = {"demos": str(tmp_path / "demos"), "num_demos": 4, "batches": 2, "batch_size": 8}
    config = tiny_runs.tiny(ProgramBCConfig, "paper", tasks=("StarsRegion",), **fields)
    assert train(config, tmp_path / "run").finished
    assert "pixels_loss" in (tmp_path / "run" / "metrics.jsonl").read_text()
    policy = load_policy(tmp_path / "run", greedy=True)
    policy.reset(np.ones(2, bool))
    layer = policy.network.pixels.policy
    with torch.no_grad():
        next(each for name, each in layer.named_parameters() if "bias" in name)[..., 7] += 100.0
    stacks = np.zeros((2, 96, 96, 12), np.uint8)
    ids = ["magical/StarsRegion-Demo-LoRes4A-v0"] * 2
    assert policy.act(stacks, ids, RolloutRng(ids, [0, 1])).tolist() == [7, 7]
