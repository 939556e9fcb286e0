"""Transformations of demonstrations: labels, pictures, and what cannot be transformed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from baselines.tests.conftest import picture_demo, write_demos
from baselines.tests.tiny_runs import checkpoint, tiny
from magical.demos import Trajectory
from magical.demos.generate import demonstrate
from magical.envs import EnvId
from magical.errors import DemonstrationsError, InvalidConfigError, UnknownNameError
from magical.observe import PRESETS
from magical.render.palette import SHADES
from magical.runs.sources import RENDERED_STATES
from magical.scene import ACTION_NAMES
from magical.scene.actions import MIRRORED_ACTIONS
from magical.scene.vocabulary import COLOURS
from magical_baselines import load_policy, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.augmentation.names import SETS
from magical_baselines.augmentation.palette import PERMUTATIONS, permute_palette
from magical_baselines.augmentation.transformations import (
    TRANSFORMATIONS,
    StackTransformations,
    parse_transformations,
)
from magical_baselines.data.expert_data import ExpertData
from magical_baselines.data.rendered_data import RenderedExpertData
from magical_baselines.models import new_statistics

TASK = "MatchRegions"
ROWS = np.array([0, 7, 30, 61])
NONE = StackTransformations.none(len(ROWS))
YES = np.array([True, False, True, False])
EXPERT_DATA = [ExpertData, RenderedExpertData]


@pytest.fixture(scope="module")
def pairs() -> list[tuple[str, Trajectory]]:
    return [(TASK, demonstrate(EnvId(TASK, "Demo"), seed=0))]


def images(
    kind: type[ExpertData], pairs: Any, transformed: StackTransformations | None, view: str = "4E"
) -> torch.Tensor:
    data = kind(pairs, [TASK], PRESETS[f"LoRes{view}"])
    rng = np.random.default_rng(0)
    return data.augmented(ROWS, SETS["none"], rng, transformed)


def test_mirrored_actions_turn_the_other_way() -> None:
    for action, mirrored in enumerate(MIRRORED_ACTIONS):
        words = ACTION_NAMES[action].split("-")
        words[1] = {"left": "right", "right": "left"}.get(words[1], words[1])
        assert ACTION_NAMES[mirrored] == "-".join(words)
    labels = replace(NONE, mirrored=YES).labels(torch.tensor([3, 3, 15, 15]))
    assert labels.tolist() == [6, 3, 12, 15]


@pytest.mark.parametrize("kind", EXPERT_DATA)
@pytest.mark.parametrize("view", ["4E", "4A"])
def test_mirrored_stacks_are_mirror_images(kind: type[ExpertData], pairs: Any, view: str) -> None:
    plain = images(kind, pairs, None, view)
    found = images(kind, pairs, replace(NONE, mirrored=YES), view)
    assert torch.equal(found[YES], plain[YES].flip(-1))
    assert torch.equal(found[~YES], plain[~YES])


@pytest.mark.parametrize("kind", EXPERT_DATA)
def test_newest_frame_in_place_of_the_earlier_ones(kind: type[ExpertData], pairs: Any) -> None:
    plain = images(kind, pairs, None)
    found = images(kind, pairs, replace(NONE, newest_only=YES))
    assert torch.equal(found[~YES], plain[~YES])
    assert torch.equal(found[YES], plain[YES][:, -3:].repeat(1, 4, 1, 1))
    assert not torch.equal(found[YES], plain[YES])


def test_palettes_are_permuted_in_whole_stacks(pairs: Any) -> None:
    number = 9
    plain = images(RenderedExpertData, pairs, None)
    numbers = np.where(YES, number, 0)
    found = images(RenderedExpertData, pairs, replace(NONE, palettes=numbers))
    assert torch.equal(found[~YES], plain[~YES])
    colours = [c for c in COLOURS if _pixels(plain[YES], c).any()]
    assert len(colours) > 1
    for colour in colours:
        new = PERMUTATIONS[number][COLOURS.index(colour)]
        before, after = _pixels(plain[YES], colour), _pixels(found[YES], new)
        assert (before != after).sum() < 0.02 * before.sum(), (colour, new)


def test_palettes_of_grey_frames_are_refused() -> None:
    with pytest.raises(InvalidConfigError, match="palette needs RGB frames, found images of 4"):
        permute_palette(torch.zeros(1, 4, 8, 8, dtype=torch.uint8), np.zeros(1, np.int64))


def test_palettes_of_recorded_frames_are_permuted_as_if_rendered(pairs: Any) -> None:
    numbers = np.array([0, 7, 16, 23])
    stored, rendered = (
        images(kind, pairs, replace(NONE, palettes=numbers)) for kind in EXPERT_DATA
    )
    assert torch.equal(stored[0], images(ExpertData, pairs, None)[0])
    channels = (stored - rendered).abs().view(len(ROWS), 4, 3, 96, 96) * 255
    differences = channels.amax(dim=2)
    assert (differences > 4).float().mean() < 0.02  # at edges
    assert (differences > 40).float().mean() < 0.005


def test_walls_cannot_be_removed_from_recorded_frames(tmp_path: Path) -> None:
    demos = write_demos(tmp_path / "demos", [picture_demo("MoveToRegion", 0)])
    config = tiny(BCConfig, demos=str(demos), num_demos=1, transform="walls")
    with pytest.raises(DemonstrationsError, match="walls needs frames that can be rendered"):
        train(config, tmp_path / "run")


def _pixels(stacks: torch.Tensor, colour: Any) -> torch.Tensor:
    """Which pixels have exactly the fill of a colour: (B, frames, H, W)."""
    frames = stacks.mul(255).round().view(len(stacks), -1, 3, *stacks.shape[2:])
    fill = torch.tensor(SHADES[colour].fill)[:, None, None]
    return (frames == fill).all(dim=2)


def test_without_walls_nothing_but_the_edge_and_the_outside_changes(pairs: Any) -> None:
    plain = images(RenderedExpertData, pairs, None, "4A")
    found = images(RenderedExpertData, pairs, replace(NONE, without_walls=YES), "4A")
    assert torch.equal(found[~YES], plain[~YES])
    corner = (slice(None), slice(None), slice(0, 2), slice(0, 2))
    assert (found[YES][corner] == 1).all()
    assert (plain[YES][corner] < 1).all()
    inside = (slice(None), slice(None), slice(8, -8), slice(8, -8))
    assert torch.equal(found[YES][inside], plain[YES][inside])


def test_samples_follow_the_generator_and_the_choice() -> None:
    everything = frozenset(TRANSFORMATIONS)
    sampled = StackTransformations.sample(4000, everything, np.random.default_rng(0))
    assert set(sampled.palettes.tolist()) == set(range(24))
    for switch in (sampled.mirrored, sampled.without_walls, sampled.newest_only):
        assert 0.45 < switch.mean() < 0.55
    rng = np.random.default_rng(0)
    only = StackTransformations.sample(4000, frozenset(["mirror"]), rng)
    assert np.array_equal(only.mirrored, sampled.mirrored)  # ablations share random numbers
    for other in (only.palettes, only.without_walls, only.newest_only):
        assert not other.any()


def test_unknown_names_are_errors() -> None:
    assert parse_transformations("none") == frozenset()
    assert parse_transformations("mirror+frames") == {"mirror", "frames"}
    with pytest.raises(UnknownNameError, match="'wall' is unknown; expected none, or some of"):
        parse_transformations("mirror+wall")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"tasks": ("MoveToCorner",), "transform": "mirror"}, "found MoveToCorner; leave out"),
        ({"transform": "walls", "augment_by": "resampling"}, "walls needs rendered frames"),
        (
            {"observation": "state", "augment": "none", "transform": "frames"},
            "state vectors are not transformed",
        ),
        ({"augment_scale": -1.0}, "augment_scale: expected at least 0"),
    ],
)
def test_what_cannot_be_is_an_error(changes: dict[str, Any], expected: str) -> None:
    fields = {"tasks": ("MoveToRegion",), "demos": "demos", **changes}
    with pytest.raises(InvalidConfigError, match=expected):
        BCConfig.preset("quick", **fields)


def test_rendered_states_are_declared() -> None:
    def sources(transform: str, **changes: str) -> tuple[str, ...]:
        fields = {"tasks": (TASK,), "demos": "demos", "transform": transform, **changes}
        return BCConfig.preset("quick", **fields).learned_from

    assert RENDERED_STATES in sources("palette")
    assert RENDERED_STATES in sources("mirror+walls")
    assert RENDERED_STATES not in sources("mirror+frames")
    assert RENDERED_STATES not in sources("palette", augment_by="resampling")


def test_statistics_are_renewed_from_all_batches_alike() -> None:
    norm = nn.BatchNorm1d(2)
    images = [torch.randn(64, 2) * scale + scale for scale in (1.0, 3.0)]
    with new_statistics(nn.Sequential(norm)):
        for batch in images:
            norm(batch)
    means = torch.stack([batch.mean(dim=0) for batch in images]).mean(dim=0)
    variances = torch.stack([batch.var(dim=0) for batch in images]).mean(dim=0)
    torch.testing.assert_close(norm.running_mean, means)
    torch.testing.assert_close(norm.running_var, variances)
    assert norm.momentum == nn.BatchNorm1d(2).momentum


def test_averaged_weights_are_the_policy_and_survive_an_interruption(
    expert_demos: Path, tmp_path: Path
) -> None:
    plain = tiny(BCConfig, demos=str(expert_demos))
    averaged = plain.replace(average_decay=0.9)
    train(averaged, tmp_path / "through")
    train(averaged, tmp_path / "twice", stop_after=3)
    train(averaged, tmp_path / "twice", resume=True)
    train(plain, tmp_path / "plain")
    found = {name: checkpoint(tmp_path / name) for name in ("through", "twice", "plain")}
    for key, value in found["through"]["policy"].items():
        assert torch.equal(value, found["twice"]["policy"][key])
        assert torch.equal(found["plain"]["policy"][key], found["through"]["network"][key])
    weights = [found[name]["policy"] for name in ("through", "plain")]
    keys = [key for key in weights[0] if "num_batches" not in key]
    assert not any(torch.equal(weights[0][key], weights[1][key]) for key in keys)
    policy = load_policy(tmp_path / "through")
    key = next(iter(policy.network.state_dict()))
    assert torch.equal(policy.network.state_dict()[key], weights[0][key])
