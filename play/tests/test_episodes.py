"""Episodes as they are shown, step by step, and frames as lossless WebP files."""

import io

import numpy as np
import pytest
from PIL import Image

from magical import get_task
from magical.demos import Dataset, Frames, Trajectory
from magical.render import render_frame
from magical.scene import Poses, View
from magical_play.episodes import GAP, SAMPLES, SIZE, RecordedEpisode, in_words, joined, render_webp


def decode(raw):
    with Image.open(io.BytesIO(raw)) as image:
        assert (image.format, image.mode) == ("WEBP", "RGB")
        return np.asarray(image)


def test_views_stand_side_by_side_and_are_encoded_exactly():
    scene = get_task("MatchRegions").demo
    poses = Poses.at_rest(scene)
    frame = decode(render_webp(scene, poses, "both"))
    ego, allo = (render_frame(scene, poses, view, SIZE, SAMPLES) for view in (View.EGO, View.ALLO))
    gap = np.full((SIZE, GAP, 3), 255)
    np.testing.assert_array_equal(frame, np.concatenate([ego, gap, allo], axis=1))


def test_actions_in_words():
    assert joined(in_words(0)) == "none"
    assert joined(in_words(1)) == "forward"
    assert in_words([0.5, -1.0, 1.0]) == ["drive 0.50", "turn -1.00", "grip 1.00"]


def test_a_recorded_episode_is_shown_step_by_step(demos):
    stored = Dataset.open(demos)[0]
    episode = RecordedEpisode(stored)
    assert episode.facts()["Last action"] == "–"
    frames = [episode.frame("allo")]
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


@pytest.mark.parametrize(("views", "width"), [(("allo", "ego"), 194), (("ego",), 96)])
def test_without_poses_the_recorded_frames_are_shown_and_no_scores(demos, views, width):
    stored = Dataset.open(demos)[0]
    frames = {view: Frames(stored, view).take(range(len(stored) + 1)) for view in views}
    facts = {"published_code_score": 1.0, "frames": frames}
    episode = RecordedEpisode(
        Trajectory(env_id=stored.env_id, scene=stored.scene, actions=stored.actions, **facts)
    )
    episode.steps = 5
    assert episode.facts()["Final score"] == "1.00 by the published code"
    assert "Score" not in episode.facts()
    np.testing.assert_array_equal(decode(episode.frame("ego")), frames["ego"][5])
    assert decode(episode.frame("both")).shape == (96, width, 3)
