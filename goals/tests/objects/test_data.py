"""Which steps of demonstrations the object-centred learner samples."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from magical.demos import Actor
from magical.demos.generate import demonstrate
from magical.envs import EnvId
from magical.errors import DemonstrationsError
from magical_goals.objects.data import ObjectData, parse_demonstrations
from magical_goals.objects.parser import parse_frames

TASK = "MoveToRegion"


def test_steps_of_a_watched_policy_are_not_sampled():
    trajectory = demonstrate(EnvId(TASK, "Demo"), seed=0)
    actors = np.full(len(trajectory), Actor.POLICY)
    actors[:12] = Actor.HUMAN
    taken_over = replace(trajectory, actors=actors)
    data = ObjectData(parse_demonstrations(((TASK, taken_over),), parse_frames), [TASK])
    rng = np.random.default_rng(0)
    assert set(data.sample_each(500, rng).tolist()) == set(range(12))
    assert data.sample_eventful(500, rng).max() < 12
    assert torch.equal(data.destinations[0], data.table.robot[12, :2])  # where the person stopped
    watched = replace(trajectory, actors=np.full(len(trajectory), Actor.POLICY))
    with pytest.raises(DemonstrationsError, match=f"{TASK}: expected steps that were demonstr"):
        parse_demonstrations(((TASK, watched),), parse_frames)


def test_standing_still_is_learned_where_no_block_is_left_to_move():
    trajectory = demonstrate(EnvId(TASK, "Demo"), seed=0)  # stands still in the region at last
    data = ObjectData(parse_demonstrations(((TASK, trajectory),), parse_frames), [TASK])
    rows = data.sample_eventful(1000, np.random.default_rng(0))
    assert set(rows.tolist()) == set(range(len(trajectory)))
