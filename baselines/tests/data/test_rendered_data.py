"""Demonstrations rendered when they are sampled, beside stored frames."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from baselines.tests.conftest import picture_demo
from baselines.tests.tiny_runs import tiny
from magical.demos import Dataset, Trajectory
from magical.demos.generate import generate
from magical.envs import EnvId
from magical.errors import DemonstrationsError
from magical.observe import PRESETS
from magical.runs.folder import RECORD, read_json
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.augmentation.augment import NOISE_STD
from magical_baselines.augmentation.names import SETS, parse_augmentations
from magical_baselines.config import IMAGE_OBSERVATIONS
from magical_baselines.data.expert_data import ExpertData
from magical_baselines.data.rendered_data import RenderedExpertData, choose_image_data

TASKS = ("MoveToRegion", "MatchRegions")
Pairs = list[tuple[str, Trajectory]]


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    """Expert demonstrations of two tasks, among them several scenes of one."""
    path = tmp_path_factory.mktemp("demos") / "data"
    found: Pairs = []
    for number, (task, variant) in enumerate(
        [("MoveToRegion", "Demo"), ("MatchRegions", "Demo"), ("MoveToRegion", "TestLayout")]
    ):
        env_id = EnvId(task, variant)
        generate(env_id, 2, path.with_name(f"{number}"), seed=1)
        found += [(task, demo) for demo in Dataset.open(path.with_name(f"{number}"))]
    return found


def both(pairs: Pairs, preset: str) -> tuple[ExpertData, RenderedExpertData]:
    spec = PRESETS[preset]
    stored = ExpertData(pairs, TASKS, spec, remove_noops=True)
    return stored, RenderedExpertData(pairs, TASKS, spec, remove_noops=True)


@pytest.mark.parametrize("preset", IMAGE_OBSERVATIONS)
def test_without_augmentation_the_frames_are_the_stored_ones(pairs: Pairs, preset: str) -> None:
    stored, rendered = both(pairs, preset)
    assert len(stored) == len(rendered)
    rows = np.random.default_rng(0).integers(len(stored), size=24)
    assert torch.equal(stored.images(rows), rendered.images(rows))
    for one, other in zip(stored.labels(rows), rendered.labels(rows), strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("preset", ["LoRes4E", "LoRes3EA"])
def test_augmented_frames_are_moved_and_coloured_as_resampled_ones(
    pairs: Pairs, preset: str
) -> None:
    """The same random numbers: what differs is interpolation, and what is beyond the borders."""
    stored, rendered = both(pairs, preset)
    rows = np.arange(0, len(stored), 7)
    for names in ("colour", "translation", "rotation", "all"):
        which = replace(parse_augmentations(names), noise=False)
        resampled = stored.augmented(rows, which, np.random.default_rng(3))
        found = rendered.augmented(rows, which, np.random.default_rng(3))
        plain = stored.augmented(rows, SETS["none"], np.random.default_rng(3))
        assert found.is_contiguous(memory_format=torch.channels_last)
        inside = slice(16, -16)
        difference = (found - resampled)[..., inside, inside].abs().mean(dim=(0, 2, 3))
        changed = (plain - resampled)[..., inside, inside].abs().mean(dim=(0, 2, 3))
        assert (difference < 0.5 * changed).all()  # in every view
        assert difference.mean() < 0.015


def test_stacks_that_are_together_are_augmented_alike(pairs: Pairs) -> None:
    which, rows = parse_augmentations("translation+rotation+colour"), np.full(6, 3)
    for data in both(pairs, "LoRes4E"):
        found = data.augmented(rows, which, np.random.default_rng(0), together=3)
        assert found.shape == (6, *data.spec.network_shape)
        equal = [[torch.equal(one, other) for other in found] for one in found]
        assert equal == np.kron(np.eye(2), np.ones((3, 3))).astype(bool).tolist()
        apart = data.augmented(rows, which, np.random.default_rng(0))
        assert not torch.equal(apart[0], apart[1])


def test_noise_is_added_last(pairs: Pairs) -> None:
    rendered = both(pairs, "LoRes4E")[1]
    rows = np.arange(20)
    plain = rendered.augmented(rows, SETS["none"], np.random.default_rng(0))
    noisy = rendered.augmented(rows, parse_augmentations("noise"), np.random.default_rng(0))
    inside = (plain > 0.1) & (plain < 0.9)  # the rest may be clamped
    deviation = float((noisy - plain)[inside].std())
    assert abs(deviation / NOISE_STD - 1.0) < 0.02


def test_auto_renders_where_all_poses_are_known(pairs: Pairs) -> None:
    run, spec = Mock(), PRESETS["LoRes4E"]

    def chosen(augment_by: str, *more: tuple[str, Trajectory]) -> tuple[type[ExpertData], str]:
        kind = choose_image_data((*pairs, *more), run, spec, augment_by)
        return kind, run.describe.call_args.kwargs["augment_by"]

    recorded = "MoveToCorner", picture_demo("MoveToCorner", 0)
    assert chosen("auto") == chosen("rendering") == (RenderedExpertData, "rendering")
    assert chosen("resampling") == chosen("auto", recorded) == (ExpertData, "resampling")
    expected = r"rendering needs .* 1 demonstrations have recorded frames only.*MoveToCorner-Demo"
    with pytest.raises(DemonstrationsError, match=f"{expected}.*magical demos import"):
        chosen("rendering", recorded)
    spec = Mock()  # another distribution's
    assert chosen("auto") == (ExpertData, "resampling")
    with pytest.raises(DemonstrationsError, match="the observation is not made of the package's"):
        chosen("rendering")


def test_auto_trains_on_rendered_frames_and_resampling_on_others(
    expert_demos: Path, tmp_path: Path
) -> None:
    found, recorded = {}, {}
    for way in ("auto", "rendering", "resampling"):
        config = tiny(BCConfig, demos=str(expert_demos), augment_by=way)
        found[way] = train(config, tmp_path / way).metrics["loss"]
        recorded[way] = read_json(tmp_path / way / RECORD)["augment_by"]
    assert found["auto"] == found["rendering"]
    assert found["auto"] != found["resampling"]
    assert recorded == {"auto": "rendering", "rendering": "rendering", "resampling": "resampling"}
