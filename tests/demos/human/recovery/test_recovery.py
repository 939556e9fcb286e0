"""Recovering poses from frames, against the poses that the frames were rendered from."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos import Frames, Trajectory, observations
from magical.demos.human.published import pack
from magical.demos.human.recovery.fit import FAR_STAGES, PoseFitter
from magical.demos.human.recovery.recovery import LIMIT, recover, recovered_trajectory
from magical.demos.store.codec import decode, encode
from magical.scene import View
from magical.scene.poses import EYES, FIRST_BLOCK, ROBOT
from tests.demos.human.recovery.conftest import Record, render

STEPS = 30  # of the episode; the block moves from the twelfth on


@pytest.fixture(scope="module")
def recovered(record: Record, pushing: Trajectory) -> Trajectory:
    return recovered_trajectory(record(pushing, STEPS))


def test_poses_are_those_that_were_rendered(recovered: Trajectory, pushing: Trajectory) -> None:
    assert pushing.poses is not None
    assert recovered.poses is not None
    errors = np.abs(recovered.poses - pushing.poses[: STEPS + 1])
    assert np.ptp(pushing.poses[: STEPS + 1, FIRST_BLOCK, 0]) > 0.1  # the block was pushed
    assert errors[:, ROBOT, :2].max() < 3e-4
    assert errors[:, FIRST_BLOCK, :2].max() < 3e-4
    assert errors[:, [ROBOT, FIRST_BLOCK], 2].max() < 3e-3
    assert errors[:, EYES, 2].max() < 0.1


def test_uncertainty_is_that_of_the_errors(record: Record, pushing: Trajectory) -> None:
    assert pushing.poses is not None
    recovery = recover(record(pushing, STEPS))
    fitted = recovery.deviations > 0
    errors = np.abs(recovery.poses - pushing.poses[: STEPS + 1])[fitted]
    ratios = errors / recovery.deviations[fitted]
    assert 0.2 < np.median(ratios) < 1.5
    assert np.mean(ratios < 3) > 0.95


def test_body_at_rest_keeps_its_pose(recovered: Trajectory, pushing: Trajectory) -> None:
    assert pushing.poses is not None
    assert recovered.poses is not None
    still = (pushing.poses[1 : STEPS + 1, FIRST_BLOCK] == pushing.poses[0, FIRST_BLOCK]).all(axis=1)
    assert still.any()
    kept = recovered.poses[1:, FIRST_BLOCK] == recovered.poses[0, FIRST_BLOCK]
    assert kept[still].all()


def test_trajectory_says_how_well_it_is_known(recovered: Trajectory) -> None:
    known = decode(encode(recovered)).metadata
    assert (known["source"], known["recorded_score"]) == ("demo.pkl.gz", 1.0)
    recovery = known["recovery"]
    assert len(recovery["wrong_pixels"]) == STEPS + 1
    assert recovery["largest_wrong_pixels"] == max(recovery["wrong_pixels"]) < 5e-4
    assert 1e-5 < recovery["deviations"]["robot"]["position"] < 1e-4
    assert recovery["unseen_poses"] == 0


def test_it_is_an_ordinary_trajectory_of_poses(
    recovered: Trajectory, record: Record, pushing: Trajectory
) -> None:
    assert recovered.score is not None
    assert recovered.frames is None
    assert len(encode(recovered)) < 20_000
    averaged = record(pushing, STEPS).averaged()
    for view in ("ego", "allo"):
        rendered = Frames(recovered, view).take(range(STEPS + 1))
        assert np.abs(rendered.astype(int) - averaged[view]).mean() < 0.02
    vectors = observations(recovered, "state")
    true = observations(pushing, "state", range(STEPS + 1))
    # Entries 4 and 5 are the robot's velocity, which is not recorded; at first it drives freely.
    assert np.median(np.abs(vectors - true)[:10, 4:6]) < 5e-3


def test_frames_are_kept_beside_the_poses(record: Record, pushing: Trajectory) -> None:
    recording = record(pushing, 2)
    kept = decode(encode(recovered_trajectory(recording, keep_frames=True)))
    assert kept.poses is not None
    assert kept.frames is not None
    np.testing.assert_array_equal(kept.frames["ego"], recording.averaged()["ego"])


def test_frame_that_fits_nowhere_is_named(record: Record, pushing: Trajectory) -> None:
    recording = record(pushing, 4)
    noise = np.random.default_rng(0).integers(256, size=(384, 384, 3), dtype=np.uint8)
    packed = {view: list(frames) for view, frames in recording.packed.items()}
    packed[View.EGO][3] = pack(noise)
    recovery = recover(replace(recording, packed=packed))
    assert recovery.problem is not None
    assert "time step 3" in recovery.problem
    assert recovery.wrong[-1] > LIMIT
    assert len(recovery.poses) == 4  # it stops there


def test_first_guess_may_be_pixels_off(pushing: Trajectory) -> None:
    assert pushing.poses is not None
    fitter, true = PoseFitter(pushing.scene), pushing.poses[STEPS]
    guess = true + np.random.default_rng(0).uniform(-0.03, 0.03, true.shape)
    guess[EYES, :2] = guess[ROBOT, :2]
    labels = fitter.label(render(pushing.scene, true))
    fit = fitter.fit(guess, labels, range(len(true)), FAR_STAGES)
    assert np.abs(fit.bodies - true)[:, :2].max() < 2e-3


@pytest.mark.parametrize("index", range(2))
def test_published_demonstrations(human_archive: Path, index: int, tmp_path: Path) -> None:
    from magical.demos.human.published import read_demonstration

    files = sorted((human_archive / "move-to-region").iterdir())
    recording = read_demonstration(files[index])
    trajectory = recovered_trajectory(recording)
    recovery: dict[str, Any] = trajectory.metadata["recovery"]
    assert trajectory.published_code_score == recording.score
    assert recovery["largest_wrong_pixels"] < 1e-3
    assert np.median(recovery["wrong_pixels"]) < 5e-4
