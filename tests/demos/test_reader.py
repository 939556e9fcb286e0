"""What is drawn from a stored trajectory is what the environment showed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.demos import Dataset, DatasetWriter, ObservationReader, Trajectory, observations
from magical.demos.reader import observation_at
from magical.demos.record import RecordTrajectories
from magical.demos.store.codec import decode, encode
from magical.errors import TrajectoryError
from magical.observe import PRESETS, PixelSpec

MakeTrajectory = Callable[..., Trajectory]
STEPS = 7
FORMS: dict[str, Any] = {
    **{preset: preset for preset in PRESETS},
    "raw": "raw",
    "state": "state",
    "own": PixelSpec((("ego", 2), ("allo", 3)), size=40, samples=2),  # type: ignore[arg-type]
}


def assert_same(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert set(a) == set(b)
        for view in a:
            assert_same(a[view], b[view])
    else:
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


def stack(shown: list[Any]) -> Any:
    if isinstance(shown[0], dict):
        return {view: np.stack([one[view] for one in shown]) for view in shown[0]}
    return np.stack(shown)


@pytest.mark.parametrize("env", ["MoveToCorner-TestAll", "ClusterShape-TestAll", "FindDupe-Demo"])
@pytest.mark.parametrize("form", FORMS)
def test_drawn_again_bit_for_bit(tmp_path: Path, env: str, form: str) -> None:
    made = gymnasium.make(f"magical/{env}-v0", observation=FORMS[form], horizon=STEPS)
    recorder = RecordTrajectories(made, tmp_path / "d", demonstrator="random")
    rng = np.random.default_rng(3)
    shown = [recorder.reset(seed=5)[0]]
    shown += [recorder.step(int(rng.integers(18)))[0] for _ in range(STEPS)]
    (trajectory,) = Dataset.open(tmp_path / "d")
    assert_same(observations(trajectory, FORMS[form]), stack(shown))
    assert_same(observations(trajectory, FORMS[form], [6, 0]), stack([shown[6], shown[0]]))
    assert_same(observation_at(trajectory, 2, FORMS[form]), shown[2])


def test_reader_writes_into_what_it_is_given(make_trajectory: MakeTrajectory) -> None:
    trajectory = make_trajectory()
    reader = ObservationReader(trajectory, "LoResCHW4E")
    out = np.zeros((3, 12, 96, 96), np.uint8)
    assert reader.read([3, 3, 12], out) is out
    assert_same(out, observations(trajectory, "LoResCHW4E", [3, 3, 12]))
    with pytest.raises(TrajectoryError, match="expected 0 to 12, found 0 to 13"):
        reader.read([0, 13])
    with pytest.raises(TrajectoryError, match="0 to 12"):
        reader.read([-1])


@pytest.mark.parametrize("preset", PRESETS)
def test_pictures_make_the_low_resolution_presets(
    make_trajectory: MakeTrajectory, preset: str
) -> None:
    posed = make_trajectory("magical/FixColour-TestAll-v0")
    frames = observations(posed, PixelSpec((("ego", 1), ("allo", 1)), separate=True))  # type: ignore[arg-type]
    assert isinstance(frames, dict)
    pictures = Trajectory(
        env_id=posed.env_id,
        scene=posed.scene,
        actions=posed.actions,
        frames=frames,
        published_code_score=posed.published_code_score,
    )
    again = decode(encode(pictures))
    assert_same(observations(again, preset), observations(posed, preset))


@pytest.mark.parametrize(
    "form", ["raw", "state", PixelSpec(size=64), PixelSpec(samples=1), {"size": 48}]
)
def test_pictures_cannot_show_the_rest(make_pictures: MakeTrajectory, form: Any) -> None:
    pictures = make_pictures()
    observations(pictures, PixelSpec(samples=4))
    with pytest.raises(TrajectoryError, match=r"recording of frames|only frames"):
        observations(pictures, form)


def test_one_recorded_view_is_not_the_other(make_pictures: MakeTrajectory) -> None:
    whole = make_pictures()
    assert whole.frames is not None
    ego = make_pictures(actions=whole.actions, frames={"ego": whole.frames["ego"]})
    assert_same(observations(ego, "LoRes4E"), observations(whole, "LoRes4E"))
    with pytest.raises(TrajectoryError, match="not allo frames"):
        observations(ego, "LoRes3EA")


def test_state_of_a_trajectory_that_physics_does_not_repeat(
    make_trajectory: MakeTrajectory,
) -> None:
    good = make_trajectory()
    assert good.poses is not None
    poses = good.poses.copy()
    poses[5, 0, 0] += 1e-12
    bent = Trajectory.from_poses(good.env_id, good.scene, good.actions, poses)
    observations(bent, "LoRes4E")
    with pytest.raises(TrajectoryError, match="departs from the recorded poses at step 5"):
        observations(bent, "state")


@pytest.mark.parametrize("preset", ["LoRes4E", "LoResStack", "state"])
def test_arrays_hold_every_step(
    tmp_path: Path, make_trajectory: MakeTrajectory, preset: str
) -> None:
    writer = DatasetWriter(tmp_path / "d")
    made = [make_trajectory(steps=steps, seed=steps) for steps in (3, 5)]
    for trajectory in made:
        writer.append(trajectory)
    dataset = Dataset.open(tmp_path / "d")
    arrays = dataset.arrays(preset=preset)
    assert arrays["episodes"].tolist() == [0] * 3 + [1] * 5
    assert arrays["steps"].tolist() == [0, 1, 2, 0, 1, 2, 3, 4]
    np.testing.assert_array_equal(
        arrays["actions"], np.concatenate([trajectory.actions for trajectory in made])
    )
    expected = [observations(trajectory, preset, range(len(trajectory))) for trajectory in made]
    if isinstance(expected[0], dict):
        expected = [{v: np.concatenate([e[v] for e in expected]) for v in expected[0]}]
        assert_same(arrays["observations"], expected[0])
    else:
        assert_same(arrays["observations"], np.concatenate(expected))
    assert arrays["env_ids"].tolist() == ["magical/MoveToCorner-Demo-v0"] * 2
    assert arrays["scores"].tolist() == [trajectory.score for trajectory in made]
    mixed = dataset.filter(demonstrator="nobody").arrays(preset="LoRes4E")
    assert len(mixed["actions"]) == 0
