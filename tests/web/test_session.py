"""A session, with time that is passed in."""

import numpy as np
import pytest

from magical.demos.summary import replay
from magical.envs import EnvId
from magical.envs.keys import Control, action_of, controls_of
from magical.errors import MessageError
from magical.experts import expert_for
from magical.experts.rollout import EpisodeExpert
from magical.scene import ACTION_NAMES, NUM_ACTIONS
from magical.web.messages import Discard, Keep, Message, Pause, Restart, Resume, Show, Start
from magical.web.session import IDLE_TIME, SILENCE_TIME, STEP_TIME, Phase
from tests.web.clocked import ENV, FORWARD, GRIP, LEFT, Clocked


def executed(clocked: Clocked) -> list[str]:
    actions = clocked.session.episode.env.get_state()["actions"]
    return [ACTION_NAMES[action] for action in actions]


def test_controls_and_actions_are_the_same_thing() -> None:
    assert [action_of(controls_of(action)) for action in range(NUM_ACTIONS)] == list(range(18))
    assert action_of({Control.FORWARD, Control.BACK, Control.GRIP}) == action_of({Control.GRIP})
    assert action_of(set(Control)) == action_of({Control.GRIP})


def test_an_episode_counts_from_the_first_key() -> None:
    clocked = Clocked()
    clocked.wait(3.0)
    assert (clocked.phase, clocked.steps) == (Phase.READY, 0)
    clocked.hold(FORWARD)
    assert (clocked.phase, clocked.steps) == (Phase.PLAYING, 1)
    assert executed(clocked) == ["forward-straight-open"]


def test_the_environment_steps_at_8_hz_and_a_short_tap_counts_for_the_next_step() -> None:
    clocked = Clocked()
    clocked.hold(FORWARD)
    clocked.hold()
    clocked.now += 0.01
    clocked.hold(LEFT)
    clocked.now += 0.01
    clocked.hold()
    clocked.wait(0.98)
    assert clocked.steps == 1 + 8
    clocked.wait(1.0, LEFT, GRIP)
    assert clocked.steps == 1 + 16
    first, second, third, *_, last = executed(clocked)
    assert (first, second) == ("forward-straight-open", "stop-left-open")
    assert (third, last) == ("stop-straight-open", "stop-left-closed")


def test_no_steps_are_made_up_for_after_a_delay() -> None:
    clocked = Clocked()
    clocked.hold(FORWARD)
    clocked.now += 1.0
    clocked.hold(FORWARD)
    assert clocked.steps == 2
    clocked.hold(FORWARD)
    assert clocked.steps == 2
    clocked.wait(STEP_TIME)
    assert clocked.steps == 3


def test_time_left_score_and_last_action_are_shown() -> None:
    clocked = Clocked(recording=True)
    first = clocked.status
    assert (first["phase"], first["seconds_left"], first["executed"]) == ("ready", 5.0, None)
    clocked.hold(FORWARD, GRIP)
    status = clocked.status
    assert (status["steps"], status["horizon"], status["seconds_left"]) == (1, 40, 4.875)
    assert status["executed"] == (Control.FORWARD, Control.GRIP)
    assert status["score"] == clocked.session.episode.env.scores().score
    assert status["number"] > first["number"]


def test_views_differ_and_do_not_disturb_the_episode() -> None:
    clocked = Clocked()
    clocked.hold(FORWARD)
    frames = set()
    for view in ("allo", "ego", "both"):
        clocked.send(Show(view))
        frames.add(clocked.session.frame())
    assert len(frames) == 3
    assert (clocked.phase, clocked.steps) == (Phase.PLAYING, 1)


def test_starting_over_keeps_the_scene_and_drops_the_episode() -> None:
    clocked = Clocked(EnvId("MoveToRegion", "TestAll"))
    seed, frame = clocked.session.episode.seed, clocked.session.frame()
    clocked.hold(FORWARD)
    clocked.wait(1.0, FORWARD)
    clocked.send(Restart())
    assert (clocked.phase, clocked.steps) == (Phase.READY, 0)
    assert (clocked.session.episode.seed, clocked.session.frame()) == (seed, frame)
    clocked.wait(1.0, FORWARD)  # a key that is still held from before is no first key
    assert clocked.phase == Phase.READY
    clocked.hold()
    clocked.hold(FORWARD)
    assert clocked.phase == Phase.PLAYING


def test_task_variant_and_seed_are_chosen() -> None:
    clocked = Clocked()
    chosen = EnvId("FindDupe", "TestAll")
    clocked.send(Start(chosen, 11))
    first = clocked.session.frame()
    assert (clocked.session.episode.env_id, clocked.session.episode.seed) == (chosen, 11)
    clocked.send(Start(chosen, None))
    assert clocked.session.frame() != first
    assert clocked.session.episode.seed != 11


def test_pausing_stops_the_clock_until_the_next_key() -> None:
    clocked = Clocked()
    clocked.hold(FORWARD)
    clocked.send(Pause())
    clocked.wait(5.0, FORWARD)
    assert (clocked.phase, clocked.steps) == (Phase.PAUSED, 1)
    clocked.hold(FORWARD, LEFT)
    assert clocked.steps == 2


def test_a_paused_episode_is_resumed_and_no_other_is_begun() -> None:
    clocked = Clocked()
    clocked.send(Resume())
    assert (clocked.phase, clocked.steps) == (Phase.READY, 0)
    clocked.hold(FORWARD)
    clocked.send(Pause())
    clocked.send(Resume())
    assert (clocked.phase, clocked.steps) == (Phase.PLAYING, 1)
    clocked.wait(1.0, FORWARD)
    assert clocked.steps > 1


def test_a_silent_page_pauses_the_episode() -> None:
    clocked = Clocked()
    clocked.hold(FORWARD)
    clocked.now += SILENCE_TIME + 0.1
    clocked.session.advance(clocked.now)
    assert (clocked.phase, clocked.steps) == (Phase.PAUSED, 1)
    assert "did not respond" in clocked.status["notice"]


def test_sessions_become_idle_without_keys() -> None:
    clocked = Clocked()
    clocked.wait(IDLE_TIME - 1.0)  # the page goes on confirming frames
    assert not clocked.session.idle(clocked.now)
    clocked.now += 2.0
    assert clocked.session.idle(clocked.now)
    clocked.send(Show("ego"))
    assert not clocked.session.idle(clocked.now)


def play_expert(clocked: Clocked) -> None:
    """Play an episode to its end with the expert's keys."""
    session = clocked.session
    expert = EpisodeExpert(expert_for(session.episode.env_id.task, seed=0))
    while session.phase is not Phase.ENDED:
        held = controls_of(expert.act(session.episode.env.state()))
        if clocked.steps == 0 and not held:
            held = (Control.GRIP,)
        clocked.now = max(clocked.now, session.step_at)
        clocked.hold(*held)


@pytest.mark.parametrize("task", ["MoveToRegion", "MoveToCorner"])
def test_a_kept_episode_replays_bit_equally(task: str) -> None:
    clocked = Clocked(EnvId(task, "TestDynamics"), recording=True)
    play_expert(clocked)
    assert clocked.status["score"] == 1.0
    clocked.send(Keep("Ada"))
    assert clocked.phase == Phase.SAVING
    trajectory = clocked.session.take_pending()
    assert trajectory is not None
    assert (trajectory.score, trajectory.demonstrator) == (1.0, "Ada")
    assert trajectory.metadata["recorder"] == "magical play"
    assert replay(trajectory).departure == 0.0
    assert clocked.session.take_pending() is None
    clocked.session.stored()
    assert (clocked.phase, clocked.session.kept, clocked.steps) == (Phase.READY, 1, 0)


def test_a_finished_episode_is_not_lost_by_accident() -> None:
    clocked = Clocked(recording=True)
    play_expert(clocked)
    for message in (Restart(), Start(ENV, None)):
        with pytest.raises(MessageError, match="keep or discard"):
            clocked.send(message)
    assert clocked.phase == Phase.ENDED
    seed = clocked.session.episode.seed
    clocked.send(Discard())
    assert clocked.phase == Phase.READY
    assert clocked.session.episode.seed != seed


def test_a_failure_to_store_leaves_the_episode_to_be_kept() -> None:
    clocked = Clocked(recording=True)
    play_expert(clocked)
    clocked.send(Keep("Ada"))
    first = clocked.session.take_pending()
    clocked.session.not_stored("the disk is full")
    assert clocked.status["notice"] == "the disk is full"
    clocked.send(Keep("Ada"))
    second = clocked.session.take_pending()
    assert first is not None
    assert second is not None
    assert np.array_equal(first.actions, second.actions)


@pytest.mark.parametrize("message", [Keep("Ada"), Discard()])
def test_only_finished_episodes_of_a_recording_server_are_kept(message: Message) -> None:
    for recording in (True, False):
        clocked = Clocked(recording=recording)
        if not recording:
            play_expert(clocked)
        with pytest.raises(MessageError, match="no finished episode"):
            clocked.send(message)
    clocked.send(Restart())  # without recording the next episode follows at once
    assert clocked.phase == Phase.READY
