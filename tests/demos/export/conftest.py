"""A dataset to export, and reading videos."""

from pathlib import Path
from typing import Any

import pytest

from magical.demos import Dataset, DatasetWriter
from tests.demos.conftest import MakeTrajectory

MISSING = "an optional extra that the pinned development environment has"


@pytest.fixture
def mixed(
    tmp_path: Path, make_trajectory: MakeTrajectory, make_frames_trajectory: MakeTrajectory
) -> Path:
    """Two environments with poses, one with frames."""
    path = tmp_path / "mixed"
    writer = DatasetWriter(path)
    for seed in (1, 2):
        writer.append(make_trajectory(steps=6, seed=seed))
    writer.append(make_trajectory("magical/MatchRegions-TestAll-v0", steps=5, seed=3))
    writer.append(make_frames_trajectory(steps=4))
    return path


@pytest.fixture
def labelled(tmp_path: Path, make_trajectory: MakeTrajectory) -> Dataset:
    """A trajectory in which a person took over from a policy, and one with labels."""
    writer = DatasetWriter(tmp_path / "labelled")
    writer.append(make_trajectory(steps=3, seed=1, actors=[0, 2, 0], demonstrator="me"))
    writer.append(make_trajectory(steps=3, seed=2, expert_actions=[17, 0, 4]))
    return Dataset.open(tmp_path / "labelled")


def decoded(av: Any, path: Path) -> list[tuple[float, Any]]:
    """The time and the array of every frame of a video."""
    with av.open(str(path)) as video:
        return [
            (float(frame.pts * frame.time_base), frame.to_ndarray(format="rgb24"))
            for frame in video.decode(video=0)
        ]
