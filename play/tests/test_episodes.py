"""Episodes as they are shown, step by step, and frames as lossless WebP files."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from magical import get_task
from magical.demos import Dataset, Frames, Trajectory
from magical.render import render_frame
from magical.scene import Poses, View
from magical_play.episodes import (
    GAP,
    SAMPLES,
    SIZE,
    RecordedEpisode,
    encode_webp,
    in_words,
    joined,
    render_webp,
)


def decode(raw: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(raw)) as image:
        assert (image.format, image.mode) == ("WEBP", "RGB")
        return np.asarray(image)


@pytest.mark.parametrize("shape", [(1, 1, 3), (5, 7, 3), (384, 776, 3)])
def test_images_are_encoded_exactly(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(256, size=shape, dtype=np.uint8)
    assert np.array_equal(decode(encode_webp([pixels])), pixels)


def test_views_stand_side_by_side() -> None:
    scene = get_task("MatchRegions").demo
    poses = Poses.at_rest(scene)
    frame = decode(render_webp(scene, poses, "both"))
    assert frame.shape == (SIZE, 2 * SIZE + GAP, 3)
    ego, allo = (render_frame(scene, poses, view, SIZE, SAMPLES) for view in (View.EGO, View.ALLO))
    assert np.array_equal(frame[:, :SIZE], ego)
    assert np.array_equal(frame[:, -SIZE:], allo)
    assert (frame[:, SIZE:-SIZE] == 255).all()


def test_actions_in_words() -> None:
    assert joined(in_words(0)) == "none"
    assert joined(in_words(1)) == "forward"
    assert in_words([0.5, -1.0, 1.0]) == ["drive 0.50", "turn -1.00", "grip 1.00"]
    assert joined(None) == "–"


def test_a_recorded_episode_is_shown_step_by_step(demos: Path) -> None:
    stored = Dataset.open(demos)[0]
    episode = RecordedEpisode(stored)
    assert episode.facts()["Last action"] == "–"
    frames = [episode.frame("allo")]
    assert stored.poses is not None
    for step in (1, episode.length):
        episode.steps = step
        facts = episode.facts()
        assert facts["Step"] == f"{step} of {len(stored)}"
        assert facts["Last action"] == joined(in_words(int(stored.actions[step - 1])))
        assert facts["To imitate"] == joined(in_words(int(stored.labels[step - 1])))
        score = stored.task.score(stored.scene, Poses(stored.poses[step]))
        assert facts["Score"] == f"{score:.2f}"
        frames.append(episode.frame("allo"))
    assert len(set(frames)) == 3
    assert decode(episode.frame("both")).shape == (SIZE, 2 * SIZE + GAP, 3)


def test_without_poses_the_recorded_frames_are_shown_and_no_scores(demos: Path) -> None:
    stored = Dataset.open(demos)[0]
    frames = {view: Frames(stored, view).take(range(len(stored) + 1)) for view in ("allo", "ego")}
    for views in (("allo", "ego"), ("ego",)):
        episode = RecordedEpisode(
            Trajectory(
                env_id=stored.env_id,
                scene=stored.scene,
                actions=stored.actions,
                published_code_score=1.0,
                frames={view: frames[view] for view in views},
                demonstrator="human",
            )
        )
        episode.steps = 5
        assert episode.facts()["Final score"] == "1.00 by the published code"
        assert "Score" not in episode.facts()
        np.testing.assert_array_equal(decode(episode.frame("ego")), frames["ego"][5])
        both = decode(episode.frame("both"))
        assert both.shape == (96, 194 if len(views) == 2 else 96, 3)
