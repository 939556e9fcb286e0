"""A session, with time that is passed in: playing, watching, taking over, recording."""

import json

import numpy as np
import pytest

from magical.demos import Actor, Dataset, DatasetWriter
from magical.demos.trajectory import replay
from magical.envs import EnvId
from magical.envs.keys import Control, action_of, controls_of
from magical.errors import DatasetError, PolicyError
from magical.experts import EpisodeExpert, expert_for, rollout
from magical.scene import ACTION_NAMES
from magical_play.episodes import PlayedEpisode
from magical_play.messages import Keep, Keys, Press, Seek, Show, Start, Watch
from magical_play.policies import Policies
from magical_play.session import MAX_UNSEEN, SILENCE_TIME, STEP_TIME, Phase, Session
from play.tests.serving import ENV

FORWARD, LEFT, GRIP = Control.FORWARD, Control.LEFT, Control.GRIP


class Clocked(Session):
    """A session with a clock of its own, whose policies answer at once."""

    now = 1000.0

    def __init__(self, env_id=ENV, record=None, *datasets):
        super().__init__(env_id, Policies(), datasets, DatasetWriter(record) if record else None)
        self.joined()

    def send(self, *messages):
        for message in messages:
            self.handle(message, self.now)
            if driver := self.take_question():
                driver.ask()
            self.advance(self.now)

    def hold(self, *held):
        self.send(Keys(frozenset(held), 0))

    def step(self, count, *held):
        for _ in range(count):
            self.now = max(self.now + STEP_TIME / 2, self.step_at)
            self.hold(*held)

    def finish(self):
        while self.phase is Phase.PLAYING:
            self.step(1)

    @property
    def at(self):
        return self.phase, self.episode.steps


def played(env_id=ENV, record=None, *datasets):
    """A session whose episode was played to its end with the expert's keys."""
    session = Clocked(env_id, record, *datasets)
    expert = EpisodeExpert(expert_for(env_id.task, seed=0))
    while session.phase is not Phase.ENDED:
        held = controls_of(expert.act(session.episode.state))
        session.now = max(session.now, session.step_at)
        session.hold(*(held or (GRIP,) if session.phase is Phase.READY else held))
    return session


def watched(record=None):
    """A session that watches the expert in the scene of seed 3."""
    session = Clocked(ENV, record)
    session.send(Start(ENV, 3, 0))
    return session


# Playing


def test_controls_and_actions_are_the_same_thing():
    assert [action_of(controls_of(action)) for action in range(18)] == list(range(18))
    assert action_of(set(Control)) == action_of({GRIP})


def test_an_episode_counts_from_the_first_key_and_steps_at_8_hz():
    session = Clocked()
    session.step(10)
    assert session.at == (Phase.READY, 0)
    session.hold(FORWARD)
    session.hold()
    for held in ((LEFT,), ()):  # a tap between two steps counts for the next one
        session.now += 0.01
        session.hold(*held)
    for _ in range(100):
        session.now += 0.01
        session.hold()
    assert session.at == (Phase.PLAYING, 1 + 8)
    names = [ACTION_NAMES[action] for action in session.episode.actions]
    assert names[:3] == ["forward-straight-open", "stop-left-open", "stop-straight-open"]
    session.now += 10 * STEP_TIME  # no steps are made up for after a delay
    session.hold(LEFT, GRIP)
    assert session.at == (Phase.PLAYING, 1 + 8 + 1)
    assert ACTION_NAMES[session.episode.actions[-1]] == "stop-left-closed"


def test_time_left_score_and_last_action_are_shown():
    session = Clocked()
    first = session.status()
    assert first["facts"] == {"Time left": "5.0 s", "Score": "0.00", "Last action": "–"}
    session.hold(FORWARD, GRIP)
    status = session.status()
    assert (status["steps"], status["length"], status["executed"]) == (1, 40, ["forward", "grip"])
    expected = {"Time left": "4.9 s", "Score": "0.00", "Last action": "forward + grip"}
    assert status["facts"] == expected
    assert "region" in status["goal"]
    assert status["number"] > first["number"]


def test_starting_over_keeps_the_scene_and_drops_the_episode():
    session = Clocked(EnvId("MoveToRegion", "TestAll"))
    scene = session.episode.seed, session.episode.frame("allo")
    session.step(8, FORWARD)
    session.send(Press("restart"))
    assert session.at == (Phase.READY, 0)
    assert (session.episode.seed, session.episode.frame("allo")) == scene
    session.step(8, FORWARD)  # a key that is still held from before is no first key
    assert session.phase == Phase.READY
    session.hold()
    session.hold(FORWARD)
    assert session.phase == Phase.PLAYING


def test_pausing_stops_the_clock_until_the_next_key_or_until_it_is_resumed():
    session = Clocked()
    session.hold(FORWARD)
    session.send(Press("pause"))
    session.step(40, FORWARD)
    assert session.at == (Phase.PAUSED, 1)
    session.hold(FORWARD, LEFT)
    assert session.at == (Phase.PLAYING, 2)
    session.send(Press("pause"), Press("resume"))
    session.step(2)
    assert session.episode.steps == 4


def test_a_page_that_confirms_nothing_gets_no_more_frames_and_is_paused():
    session = Clocked()
    session.handle(Keys(frozenset({FORWARD}), 0), session.now)
    numbers = []
    while session.phase is Phase.PLAYING:
        numbers += [session.status()["number"]] * bool(session.take_update(session.now))
        session.now += STEP_TIME
        session.advance(session.now)
    assert len(numbers) == MAX_UNSEEN
    assert session.episode.steps == pytest.approx(SILENCE_TIME / STEP_TIME, abs=1)
    assert "did not respond" in session.notice
    session.handle(Keys(frozenset(), numbers[-1]), session.now)
    assert session.take_update(session.now)


def test_a_new_page_gets_what_is_offered_and_the_state():
    session = Clocked(EnvId("Generated0003", "Demo"))
    session.hold(FORWARD)
    session.joined()
    texts = [part for part in session.take_update(session.now) if isinstance(part, str)]
    offer, status = map(json.loads, texts)
    assert offer["tasks"]["Generated0003"]["Demo"] == "magical/Generated0003-Demo-v0"
    assert offer["tasks"]["FindDupe"]["TestAll"] == "magical/FindDupe-TestAll-v0"
    assert offer["policies"] == ["expert"]
    assert (status["phase"], status["steps"]) == ("paused", 1)


def failing(error):
    def fail(*_):
        raise error

    return fail


def test_a_task_that_fails_is_said_and_the_session_goes_on(monkeypatch):
    session = Clocked()
    session.hold(FORWARD)
    monkeypatch.setattr(PlayedEpisode, "act", failing(ZeroDivisionError("no blocks")))
    session.step(1)
    assert (session.phase, session.notice) == (Phase.PAUSED, "ZeroDivisionError: no blocks")


# Recording


def test_a_kept_episode_replays_bit_equally(tmp_path):
    env_id = EnvId("MoveToRegion", "TestDynamics")
    session = played(env_id, tmp_path)
    seed, actions = session.episode.seed, session.episode.actions
    assert session.status()["facts"]["Score"] == "1.00"
    session.send(Keep("Ada"))
    assert (*session.at, session.kept) == (Phase.READY, 0, 1)
    (stored,) = Dataset.open(tmp_path)
    assert (stored.env_id, stored.seed, stored.actors) == (env_id, seed, None)
    assert (stored.score, stored.demonstrator) == (1.0, "Ada")
    assert stored.actions.tolist() == actions
    assert replay(stored).departure == 0.0


def test_a_finished_episode_is_not_lost_by_accident(tmp_path, monkeypatch):
    session = played(ENV, tmp_path, tmp_path)
    for message in (Press("restart"), Start(ENV, None, None), Watch(0, 0)):
        session.send(message)
        assert (session.phase, session.can_keep) == (Phase.ENDED, True)
        assert session.notice == "keep or discard this episode first"
    with monkeypatch.context() as patch:
        patch.setattr(DatasetWriter, "append", failing(DatasetError("the disk is full")))
        session.send(Keep("Ada"))
    assert (session.notice, session.can_keep) == ("the disk is full", True)
    session.send(Press("discard"))
    assert (*session.at, session.kept) == (Phase.READY, 0, 0)
    assert not len(Dataset.open(tmp_path))
    session.send(Start(EnvId("MoveToRegion", "TestAll"), 11, None))
    assert (session.episode.env_id.variant, session.episode.seed) == ("TestAll", 11)
    session.send(Start(ENV, None, None))  # another scene
    assert session.episode.seed != 11


@pytest.mark.parametrize("message", [Keep("Ada"), Press("discard")])
def test_only_finished_episodes_in_which_a_person_acted_are_kept_if_recording(message, tmp_path):
    automatic = watched(tmp_path)
    automatic.finish()
    for session in (Clocked(ENV, tmp_path), automatic, played()):
        session.send(message)
        assert "no finished episode" in session.notice
        session.send(Press("restart"))  # the next episode follows at once
        assert session.phase == (Phase.PLAYING if session is automatic else Phase.READY)


# Watching a policy, and taking over from it


def test_a_watched_policy_acts_from_the_start_as_it_would_alone():
    session = watched()
    status = session.status()
    assert (status["policy_name"], status["policy_acts"]) == ("expert", True)
    session.finish()
    assert session.episode.actions == rollout("MoveToRegion", "Demo", 3).actions.tolist()


def test_an_intervention_is_recorded_as_such_and_shown(tmp_path, monkeypatch):
    told = []
    note = EpisodeExpert.note_executed
    monkeypatch.setattr(
        EpisodeExpert, "note_executed", lambda self, a: (told.append(a), note(self, a))
    )
    session = watched(tmp_path)
    session.step(3)
    session.step(4, LEFT, GRIP)
    session.step(2)  # no key: still the person's turn
    assert (session.status()["policy_acts"], session.status()["executed"]) == (False, [])
    session.send(Press("hand_back"), Press("pause"), Press("hand_back"))
    session.finish()
    assert told == session.episode.actions[:-1]
    session.send(Keep("Ada"))
    assert (session.status()["policy"], session.phase) == (0, Phase.PLAYING)  # the next episode
    (stored,) = Dataset.open(tmp_path)
    human = stored.actors == Actor.HUMAN
    assert human.sum() == 6
    first = int(np.argmax(human))
    np.testing.assert_array_equal(np.flatnonzero(human), np.arange(first, first + 6))
    assert {controls_of(action) for action in stored.actions[human].tolist()} == {(LEFT, GRIP), ()}
    np.testing.assert_array_equal(stored.actions[~human], stored.policy_actions[~human])
    assert (stored.actions[human] != stored.policy_actions[human]).any()
    assert stored.is_demonstrated.all()  # the expert and the person are demonstrators both
    assert (stored.score, stored.metadata["policy"]) == (1.0, "expert")  # the expert recovered
    assert replay(stored).departure == 0.0
    session = Clocked(ENV, None, tmp_path)
    session.send(Watch(0, 0))
    for step, actor in ((0, "–"), (first, "expert"), (first + 1, "human")):
        session.send(Seek(step))
        facts = session.status()["facts"]
        assert (facts["Acted"], facts["By"], facts["Policy"]) == (actor, "Ada", "expert")


def test_the_environment_waits_for_a_slow_policy_and_late_answers_have_no_effect():
    session = Clocked()
    session.handle(Start(ENV, 3, 0), session.now)
    driver = session.take_question()
    assert session.take_question() is None  # asked once for each state
    for _ in range(round(2 * SILENCE_TIME / STEP_TIME)):
        session.now += STEP_TIME
        session.advance(session.now)
    assert session.at == (Phase.PLAYING, 0)
    session.handle(Press("restart"), session.now)
    driver.ask()
    session.advance(session.now + STEP_TIME)
    assert session.episode.steps == 0
    session.step(2)  # in the first the new one is asked
    assert session.episode.steps == 1


def test_no_policy_is_playing_again_and_an_unknown_one_changes_nothing():
    session = watched()
    session.step(2)
    session.send(Start(ENV, 3, 1))
    assert session.notice == "policy: expected a number up to 0, found 1"
    assert session.status()["policy"] == 0
    session.send(Start(ENV, 3, None))
    assert (session.status()["policy"], session.phase) == (None, Phase.READY)
    session.send(Press("hand_back"))
    assert "no policy to hand back to" in session.notice


def test_a_policy_that_fails_leaves_the_environment_to_the_person(monkeypatch):
    monkeypatch.setattr(EpisodeExpert, "act", failing(PolicyError("no such observation")))
    session = watched()
    session.step(1)
    status = session.status()
    assert (status["policy"], status["phase"], status["seed"]) == (None, "ready", 3)
    assert status["notice"] == "no such observation"


# Watching recorded episodes


def test_the_episodes_of_a_dataset_are_listed_newest_first(demos, tmp_path):
    session = Clocked(ENV, None, demos, tmp_path / "none")
    session.handle(Watch(0, None), session.now)
    stored = Dataset.open(demos)[1]
    newest, oldest = json.loads(session.take_update(session.now)[1])["episodes"]
    assert newest == [1, "MoveToRegion", "Demo", stored.score, "expert", 2]
    assert (oldest[0], oldest[-1]) == (0, 1)
    for message in (Watch(2, None), Watch(2, 0), Watch(0, 2), Watch(1, None)):
        session.send(message)
        assert "expected " in session.notice
    assert isinstance(session.episode, PlayedEpisode)


def test_a_recorded_episode_plays_stops_and_is_sought(demos):
    session = Clocked(ENV, None, demos)
    session.send(Seek(1))
    assert "expected a recorded episode" in session.notice
    session.send(Watch(0, 1))
    session.step(2, LEFT)  # keys have no effect
    assert (session.episode.seed, *session.at) == (2, Phase.PLAYING, 2)
    session.send(Seek(30))
    session.step(2)
    assert session.at == (Phase.PAUSED, 30)
    session.send(Press("resume"))
    session.finish()
    assert (*session.at, session.can_keep) == (Phase.ENDED, 40, False)
    session.send(Seek(10**6))
    assert session.at == (Phase.PAUSED, 40)
    session.send(Press("restart"), Show("allo", 4.0))
    session.now = session.step_at
    session.hold()
    assert session.at == (Phase.PLAYING, 1)
    assert session.step_at - session.now == pytest.approx(STEP_TIME / 4)
    session.send(Start(ENV, 3, None))
    assert session.at == (Phase.READY, 0)
