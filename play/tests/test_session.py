"""A session, with time that is passed in: playing, watching, taking over, recording."""

import json
from pathlib import Path
from typing import Any

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
from magical_play.messages import Keep, Keys, Message, Press, Seek, Show, Start, Watch
from magical_play.policies import Policies
from magical_play.session import MAX_UNSEEN, SILENCE_TIME, STEP_TIME, Phase, Session
from play.tests.serving import ENV

FORWARD, LEFT, GRIP = Control.FORWARD, Control.LEFT, Control.GRIP


class Clocked(Session):
    """A session with a clock of its own, whose policies answer at once."""

    now = 1000.0

    def __init__(self, env_id: EnvId = ENV, record: Path | None = None, *datasets: Path) -> None:
        super().__init__(env_id, Policies(), datasets, DatasetWriter(record) if record else None)
        self.joined()

    def send(self, message: Message) -> None:
        self.handle(message, self.now)
        if driver := self.take_question():
            driver.ask()
        self.advance(self.now)

    def hold(self, *held: Control) -> None:
        self.send(Keys(frozenset(held), 0))

    def step(self, count: int, *held: Control) -> None:
        for _ in range(count):
            self.now = max(self.now + STEP_TIME / 2, self.step_at)
            self.hold(*held)

    def finish(self) -> None:
        while self.phase is Phase.PLAYING:
            self.step(1)

    @property
    def at(self) -> tuple[Phase, int]:
        return self.phase, self.episode.steps

    @property
    def played(self) -> PlayedEpisode:
        assert isinstance(self.episode, PlayedEpisode)
        return self.episode


def played(env_id: EnvId = ENV, record: Path | None = None, *datasets: Path) -> Clocked:
    """A session whose episode was played to its end with the expert's keys."""
    session = Clocked(env_id, record, *datasets)
    expert = EpisodeExpert(expert_for(env_id.task, seed=0))
    while session.phase is not Phase.ENDED:
        held = controls_of(expert.act(session.played.state))
        session.now = max(session.now, session.step_at)
        session.hold(*(held or (GRIP,) if session.phase is Phase.READY else held))
    return session


def watched(record: Path | None = None) -> Clocked:
    """A session that watches the expert in the scene of seed 3."""
    session = Clocked(ENV, record)
    session.send(Start(ENV, 3, 0))
    return session


# Playing


def test_controls_and_actions_are_the_same_thing() -> None:
    assert [action_of(controls_of(action)) for action in range(18)] == list(range(18))
    assert action_of({Control.FORWARD, Control.BACK, GRIP}) == action_of(set(Control))
    assert action_of(set(Control)) == action_of({GRIP})


def test_an_episode_counts_from_the_first_key_and_steps_at_8_hz() -> None:
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
    session.step(2, LEFT, GRIP)
    names = [ACTION_NAMES[action] for action in session.played.actions]
    assert names[:3] == ["forward-straight-open", "stop-left-open", "stop-straight-open"]
    assert names[-1] == "stop-left-closed"


def test_no_steps_are_made_up_for_after_a_delay() -> None:
    session = Clocked()
    for seconds, steps in ((0.0, 1), (1.0, 2), (0.0, 2), (STEP_TIME, 3)):
        session.now += seconds
        session.hold(FORWARD)
        assert session.episode.steps == steps


def test_time_left_score_and_last_action_are_shown() -> None:
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
    assert played().status()["facts"]["Score"] == "1.00"


def test_starting_over_keeps_the_scene_and_drops_the_episode() -> None:
    session = Clocked(EnvId("MoveToRegion", "TestAll"))
    seed, frame = session.episode.seed, session.episode.frame("allo")
    session.hold(FORWARD)
    session.step(8, FORWARD)
    session.send(Press("restart"))
    assert session.at == (Phase.READY, 0)
    assert (session.episode.seed, session.episode.frame("allo")) == (seed, frame)
    session.step(8, FORWARD)  # a key that is still held from before is no first key
    assert session.phase == Phase.READY
    session.hold()
    session.hold(FORWARD)
    assert session.phase == Phase.PLAYING


def test_pausing_stops_the_clock_until_the_next_key_or_until_it_is_resumed() -> None:
    session = Clocked()
    session.send(Press("resume"))
    assert session.phase is Phase.READY
    session.hold(FORWARD)
    session.send(Press("pause"))
    session.step(40, FORWARD)
    assert session.at == (Phase.PAUSED, 1)
    session.hold(FORWARD, LEFT)
    assert session.at == (Phase.PLAYING, 2)
    session.send(Press("pause"))
    session.send(Press("resume"))
    session.step(2)
    assert session.episode.steps == 4


def test_a_page_that_confirms_nothing_gets_no_more_frames_and_is_paused() -> None:
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


def test_a_new_page_gets_what_is_offered_and_the_state() -> None:
    session = Clocked(EnvId("Generated0003", "Demo"))
    session.hold(FORWARD)
    session.joined()
    texts = [part for part in session.take_update(session.now) if isinstance(part, str)]
    offer, status = map(json.loads, texts)
    assert offer["tasks"]["Generated0003"]["Demo"] == "magical/Generated0003-Demo-v0"
    assert offer["tasks"]["FindDupe"]["TestAll"] == "magical/FindDupe-TestAll-v0"
    assert offer["policies"] == ["expert"]
    assert (status["phase"], status["steps"]) == ("paused", 1)


def test_a_task_that_fails_is_said_and_the_session_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError("no blocks")

    session = Clocked()
    session.hold(FORWARD)
    monkeypatch.setattr(PlayedEpisode, "act", fail)
    session.step(1)
    assert (session.phase, session.notice) == (Phase.PAUSED, "ZeroDivisionError: no blocks")


# Recording


@pytest.mark.parametrize("task", ["MoveToRegion", "MoveToCorner"])
def test_a_kept_episode_replays_bit_equally(task: str, tmp_path: Path) -> None:
    session = played(EnvId(task, "TestDynamics"), tmp_path)
    seed, actions = session.episode.seed, session.played.actions
    session.send(Keep("Ada"))
    assert (*session.at, session.kept) == (Phase.READY, 0, 1)
    (stored,) = Dataset.open(tmp_path)
    assert (stored.env_id, stored.seed) == (EnvId(task, "TestDynamics"), seed)
    assert (stored.score, stored.demonstrator, stored.actors) == (1.0, "Ada", None)
    assert stored.metadata["recorder"] == "magical play"
    assert stored.actions.tolist() == actions
    assert replay(stored).departure == 0.0


def test_a_finished_episode_is_not_lost_by_accident(tmp_path: Path) -> None:
    session = played(ENV, tmp_path, tmp_path)
    seed = session.episode.seed
    for message in (Press("restart"), Start(ENV, None, None), Watch(0, 0)):
        session.send(message)
        assert (session.phase, session.can_keep) == (Phase.ENDED, True)
        assert session.notice == "keep or discard this episode first"
    session.send(Press("discard"))
    assert (*session.at, session.kept) == (Phase.READY, 0, 0)
    assert session.episode.seed != seed
    assert not len(Dataset.open(tmp_path))


def test_task_variant_and_seed_are_chosen_and_stay(tmp_path: Path) -> None:
    session, chosen = Clocked(ENV, tmp_path), EnvId("MoveToRegion", "TestAll")
    session.send(Start(chosen, 11, None))
    first = session.episode.frame("allo")
    session.hold(FORWARD)
    session.finish()
    session.send(Press("discard"))
    assert (session.episode.env_id, session.episode.seed) == (chosen, 11)
    session.send(Start(chosen, None, None))  # another scene
    assert session.episode.seed != 11
    assert session.episode.frame("allo") != first


def test_a_failure_to_store_leaves_the_episode_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise DatasetError("the disk is full")

    session = played(ENV, tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(DatasetWriter, "append", full)
        session.send(Keep("Ada"))
    assert (session.notice, session.can_keep) == ("the disk is full", True)
    session.send(Keep("Ada"))
    assert session.kept == len(Dataset.open(tmp_path)) == 1


@pytest.mark.parametrize("message", [Keep("Ada"), Press("discard")])
def test_only_finished_episodes_in_which_a_person_acted_are_kept_if_recording(
    message: Message, tmp_path: Path
) -> None:
    automatic = watched(tmp_path)
    automatic.finish()
    for session in (Clocked(ENV, tmp_path), automatic, played()):
        session.send(message)
        assert "no finished episode" in session.notice
        session.send(Press("restart"))  # the next episode follows at once
        assert session.phase == (Phase.PLAYING if session is automatic else Phase.READY)


# Watching a policy, and taking over from it


def test_a_watched_policy_acts_from_the_start_as_it_would_alone() -> None:
    session = watched()
    status = session.status()
    assert status["phase"] == "playing"
    assert (status["policy_name"], status["policy_acts"]) == ("expert", True)
    session.finish()
    assert session.played.actions == rollout("MoveToRegion", "Demo", 3).actions.tolist()
    assert session.played.score == 1.0


def test_a_key_takes_over_and_the_policy_goes_on_when_it_is_handed_back_to() -> None:
    session = watched()
    session.step(3)
    session.step(4, LEFT)
    assert (session.status()["policy_acts"], session.status()["executed"]) == (False, ["left"])
    session.step(2)  # no key: still the person's turn
    assert session.status()["executed"] == []
    session.send(Press("hand_back"))
    assert session.status()["policy_acts"] is True
    session.step(3)
    session.send(Press("pause"))
    steps = session.episode.steps
    session.step(3)
    assert session.at == (Phase.PAUSED, steps)
    session.send(Press("hand_back"))
    session.finish()
    actors = session.played.actors
    taken = [step for step, actor in enumerate(actors) if actor is Actor.HUMAN]
    assert taken == list(range(taken[0], taken[0] + 6))
    assert set(actors) == {Actor.EXPERT, Actor.HUMAN}
    assert session.played.score == 1.0  # the expert recovered from where it was led


def test_the_expert_is_told_what_was_executed(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []
    monkeypatch.setattr(EpisodeExpert, "note_executed", lambda _, action: told.append(action))
    session = watched()
    session.step(3)
    session.step(4, LEFT)
    assert told == session.played.actions


def test_an_intervention_is_recorded_as_such_and_shown(tmp_path: Path) -> None:
    session = watched(tmp_path)
    session.step(3)
    session.step(5, LEFT, GRIP)
    session.send(Press("hand_back"))
    session.finish()
    session.send(Keep("Ada"))
    assert (session.status()["policy"], session.phase) == (0, Phase.PLAYING)  # the next episode
    (stored,) = Dataset.open(tmp_path)
    assert stored.actors is not None
    assert stored.policy_actions is not None
    human = stored.actors == Actor.HUMAN
    assert human.sum() == 5
    assert {controls_of(action) for action in stored.actions[human].tolist()} == {(LEFT, GRIP)}
    np.testing.assert_array_equal(stored.actions[~human], stored.policy_actions[~human])
    assert (stored.actions[human] != stored.policy_actions[human]).any()
    np.testing.assert_array_equal(stored.labels, stored.actions)
    assert stored.is_demonstrated.all()  # the expert and the person are demonstrators both
    assert (stored.demonstrator, stored.metadata["policy"]) == ("Ada", "expert")
    assert replay(stored).departure == 0.0
    session = Clocked(ENV, None, tmp_path)
    session.send(Watch(0, 0))
    first = int(np.argmax(human))
    for step, actor in ((0, "–"), (first, "expert"), (first + 1, "human")):
        session.send(Seek(step))
        facts = session.status()["facts"]
        assert (facts["Acted"], facts["By"], facts["Policy"]) == (actor, "Ada", "expert")


def test_the_environment_waits_for_a_slow_policy_and_late_answers_have_no_effect() -> None:
    session = Clocked()
    session.handle(Start(ENV, 3, 0), session.now)
    driver = session.take_question()
    assert driver is not None
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


def test_no_policy_is_playing_again_and_an_unknown_one_changes_nothing() -> None:
    session = watched()
    session.step(2)
    before = session.episode.steps
    session.send(Start(ENV, 3, 1))
    assert session.notice == "policy: expected a number up to 0, found 1"
    assert (session.status()["policy"], session.episode.steps) == (0, before)
    session.send(Start(ENV, 3, None))
    assert (session.status()["policy"], session.phase) == (None, Phase.READY)
    session.send(Press("hand_back"))
    assert "no policy to hand back to" in session.notice


def test_a_policy_that_fails_leaves_the_environment_to_the_person(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: Any) -> int:
        raise PolicyError("no such observation")

    monkeypatch.setattr(EpisodeExpert, "act", fail)
    session = watched()
    session.step(1)
    status = session.status()
    assert (status["policy"], status["phase"], status["seed"]) == (None, "ready", 3)
    assert status["notice"] == "no such observation"


# Watching recorded episodes


def test_the_episodes_of_a_dataset_are_listed_newest_first(demos: Path, tmp_path: Path) -> None:
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


def test_a_recorded_episode_plays_stops_and_is_sought(demos: Path) -> None:
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
    session.send(Press("restart"))
    session.send(Show("allo", 4.0))
    session.now = session.step_at
    session.hold()
    assert session.at == (Phase.PLAYING, 1)
    assert session.step_at - session.now == pytest.approx(STEP_TIME / 4)
    session.send(Start(ENV, 3, None))
    assert session.at == (Phase.READY, 0)
