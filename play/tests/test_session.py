"""A session, with time that is passed in: playing, watching, taking over, recording."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos import Actor, Dataset, DatasetWriter, Trajectory
from magical.demos.replay import replay
from magical.envs import EnvId
from magical.envs.keys import Control, action_of, controls_of
from magical.errors import DatasetError, PolicyError
from magical.experts import EpisodeExpert, expert_for, rollout
from magical.scene import ACTION_NAMES, NUM_ACTIONS
from magical_play.episodes import PlayedEpisode
from magical_play.messages import (
    Keep,
    Keys,
    Message,
    Press,
    Seek,
    Show,
    Start,
    Watch,
)
from magical_play.policies import Policies
from magical_play.session import MAX_UNSEEN, SILENCE_TIME, STEP_TIME, Phase, Session
from play.tests.serving import ENV

FORWARD, LEFT, GRIP = Control.FORWARD, Control.LEFT, Control.GRIP


class Clocked(Session):
    """A session with a clock of its own, whose page confirms every frame.

    A policy that is watched answers at once.
    """

    now = 1000.0

    def __init__(
        self, env_id: EnvId = ENV, record: Path | None = None, datasets: tuple[Path, ...] = ()
    ) -> None:
        writer = DatasetWriter(record) if record else None
        super().__init__(env_id, Policies(), datasets, writer)
        self.joined()

    def send(self, message: Message) -> None:
        self.handle(message, self.now)
        if question := self.take_question():
            question.ask()
        self.advance(self.now)
        self.take_update(self.now)
        self._unseen.clear()

    def hold(self, *held: Control) -> None:
        self.send(Keys(frozenset(held), 0))

    def step(self, count: int, *held: Control) -> None:
        for _ in range(count):
            self.now = max(self.now + STEP_TIME / 2, self.step_at)
            self.hold(*held)

    def finish(self, *held: Control) -> None:
        while self.phase is Phase.PLAYING:
            self.step(1, *held)

    @property
    def played(self) -> PlayedEpisode:
        assert isinstance(self.episode, PlayedEpisode)
        return self.episode

    @property
    def executed(self) -> list[str]:
        return [ACTION_NAMES[action] for action in self.played.actions]


def played(env_id: EnvId = ENV, record: Path | None = None) -> Clocked:
    """A session whose episode was played to its end with the expert's keys."""
    session = Clocked(env_id, record)
    expert = EpisodeExpert(expert_for(env_id.task, seed=0))
    while session.phase is not Phase.ENDED:
        held = controls_of(expert.act(session.played.state))
        session.now = max(session.now, session.step_at)
        session.hold(*(held or (GRIP,) if session.phase is Phase.READY else held))
    return session


def watched(record: Path | None = None) -> Clocked:
    """A session that watches the expert in the scene of seed 3."""
    session = Clocked(record=record)
    session.send(Start(ENV, 3, 0))
    return session


# Playing


def test_controls_and_actions_are_the_same_thing() -> None:
    assert [action_of(controls_of(action)) for action in range(NUM_ACTIONS)] == list(range(18))
    assert action_of({Control.FORWARD, Control.BACK, Control.GRIP}) == action_of({Control.GRIP})
    assert action_of(set(Control)) == action_of({Control.GRIP})


def test_an_episode_counts_from_the_first_key() -> None:
    session = Clocked()
    session.step(10)
    assert (session.phase, session.episode.steps) == (Phase.READY, 0)
    session.hold(FORWARD)
    assert (session.phase, session.executed) == (Phase.PLAYING, ["forward-straight-open"])


def test_the_environment_steps_at_8_hz_and_a_short_tap_counts_for_the_next_step() -> None:
    session = Clocked()
    session.hold(FORWARD)
    session.hold()
    session.now += 0.01
    session.hold(LEFT)
    session.now += 0.01
    session.hold()
    for _ in range(100):
        session.now += 0.01
        session.hold()
    assert session.episode.steps == 1 + 8
    session.step(2, LEFT, GRIP)
    first, second, third, *_, last = session.executed
    assert (first, second) == ("forward-straight-open", "stop-left-open")
    assert (third, last) == ("stop-straight-open", "stop-left-closed")


def test_no_steps_are_made_up_for_after_a_delay() -> None:
    session = Clocked()
    session.hold(FORWARD)
    session.now += 1.0
    session.hold(FORWARD)
    assert session.episode.steps == 2
    session.hold(FORWARD)
    assert session.episode.steps == 2
    session.now += STEP_TIME
    session.hold(FORWARD)
    assert session.episode.steps == 3


def test_time_left_score_and_last_action_are_shown() -> None:
    session = Clocked()
    first = session.status()
    assert first["facts"] == {"Time left": "5.0 s", "Score": "0.00", "Last action": "–"}
    session.hold(FORWARD, GRIP)
    status = session.status()
    assert (status["steps"], status["length"]) == (1, 40)
    assert status["facts"]["Time left"] == "4.9 s"
    assert (status["facts"]["Last action"], status["executed"]) == (
        "forward + grip",
        ["forward", "grip"],
    )
    assert status["goal"]
    assert status["number"] > first["number"]
    assert played().status()["facts"]["Score"] == "1.00"


def test_views_differ_and_do_not_disturb_the_episode() -> None:
    session = Clocked()
    session.hold(FORWARD)
    frames = set()
    for view in ("allo", "ego", "both"):
        session.handle(Show(view, 1.0), session.now)
        frames.add(session.take_update(session.now)[-1])
    assert len(frames) == 3
    assert (session.phase, session.episode.steps) == (Phase.PLAYING, 1)


def test_starting_over_keeps_the_scene_and_drops_the_episode() -> None:
    session = Clocked(EnvId("MoveToRegion", "TestAll"))
    seed, frame = session.episode.seed, session.episode.frame("allo")
    session.hold(FORWARD)
    session.step(8, FORWARD)
    session.send(Press("restart"))
    assert (session.phase, session.episode.steps) == (Phase.READY, 0)
    assert (session.episode.seed, session.episode.frame("allo")) == (seed, frame)
    session.step(8, FORWARD)  # a key that is still held from before is no first key
    assert session.phase == Phase.READY
    session.hold()
    session.hold(FORWARD)
    assert session.phase == Phase.PLAYING


def test_task_variant_and_seed_are_chosen() -> None:
    session, chosen = Clocked(), EnvId("FindDupe", "TestAll")
    session.send(Start(chosen, 11, None))
    assert (session.episode.env_id, session.episode.seed) == (chosen, 11)
    first = session.episode.frame("allo")
    session.send(Start(chosen, None, None))
    assert session.episode.seed != 11
    assert session.episode.frame("allo") != first


def test_pausing_stops_the_clock_until_the_next_key_or_until_it_is_resumed() -> None:
    session = Clocked()
    session.send(Press("resume"))
    assert session.phase is Phase.READY
    session.hold(FORWARD)
    session.send(Press("pause"))
    session.step(40, FORWARD)
    assert (session.phase, session.episode.steps) == (Phase.PAUSED, 1)
    session.hold(FORWARD, LEFT)
    assert (session.phase, session.episode.steps) == (Phase.PLAYING, 2)
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
    offer, status, frame = session.take_update(session.now)
    assert '"Generated0003": {"Demo": "magical/Generated0003-Demo-v0"' in str(offer)
    assert '"policies": ["expert"]' in str(offer)
    assert '"phase": "paused"' in str(status)
    assert isinstance(frame, bytes)


def test_a_task_that_fails_is_said_and_the_session_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    session = Clocked()
    session.hold(FORWARD)

    def fail(*_: Any) -> None:
        raise ZeroDivisionError("no blocks")

    monkeypatch.setattr(PlayedEpisode, "act", fail)
    session.step(1)
    assert (session.phase, session.notice) == (Phase.PAUSED, "ZeroDivisionError: no blocks")


# Recording


@pytest.mark.parametrize("task", ["MoveToRegion", "MoveToCorner"])
def test_a_kept_episode_replays_bit_equally(task: str, tmp_path: Path) -> None:
    session = played(EnvId(task, "TestDynamics"), tmp_path)
    session.send(Keep("Ada"))
    assert (session.phase, session.kept, session.episode.steps) == (Phase.READY, 1, 0)
    (stored,) = Dataset.open(tmp_path)
    assert (stored.score, stored.demonstrator, stored.actors) == (1.0, "Ada", None)
    assert stored.metadata["recorder"] == "magical play"
    assert replay(stored).departure == 0.0


def test_a_finished_episode_is_not_lost_by_accident(tmp_path: Path) -> None:
    session = played(record=tmp_path)
    session._datasets = (tmp_path,)
    for message in (Press("restart"), Start(ENV, None, None), Watch(0, 0)):
        session.send(message)
        assert (session.phase, session.can_keep) == (Phase.ENDED, True)
        assert session.notice == "keep or discard this episode first"
    seed = session.episode.seed
    session.send(Press("discard"))
    assert (session.phase, session.kept) == (Phase.READY, 0)
    assert session.episode.seed != seed
    assert not len(Dataset.open(tmp_path))


def test_a_chosen_seed_stays_until_another_scene_is_asked_for(tmp_path: Path) -> None:
    session = Clocked(record=tmp_path)
    session.send(Start(ENV, 3, None))
    session.hold(FORWARD)
    session.finish()
    session.send(Press("discard"))
    assert session.episode.seed == 3
    session.send(Start(ENV, None, None))
    assert session.episode.seed != 3


def test_a_failure_to_store_leaves_the_episode_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = played(record=tmp_path)

    def full(*_: Any) -> None:
        raise DatasetError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(DatasetWriter, "append", full)
        session.send(Keep("Ada"))
    assert (session.notice, session.can_keep) == ("the disk is full", True)
    session.send(Keep("Ada"))
    assert session.kept == 1


@pytest.mark.parametrize("message", [Keep("Ada"), Press("discard")])
def test_only_finished_episodes_of_a_recording_server_are_kept(
    message: Message, tmp_path: Path
) -> None:
    for session in (Clocked(record=tmp_path), played()):
        session.send(message)
        assert "no finished episode" in session.notice
    session.send(Press("restart"))  # without recording the next episode follows at once
    assert session.phase == Phase.READY


# Watching a policy, and taking over from it


def test_a_watched_policy_acts_from_the_start_as_it_would_alone() -> None:
    session = watched()
    status = session.status()
    assert (status["phase"], status["policy_name"], status["policy_acts"]) == (
        "playing",
        "expert",
        True,
    )
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
    session.finish()
    actors = session.played.actors
    taken = [step for step, actor in enumerate(actors) if actor is Actor.HUMAN]
    assert taken == list(range(taken[0], taken[0] + 6))
    assert set(actors) == {Actor.EXPERT, Actor.HUMAN}
    assert session.played.score == 1.0  # the expert recovered from where it was led


def intervened(record: Path) -> Trajectory:
    """The stored episode of an expert from which a person took over for five steps."""
    session = watched(record)
    session.step(3)
    session.step(5, LEFT, GRIP)
    session.send(Press("hand_back"))
    session.finish()
    session.send(Keep("Ada"))
    assert (session.status()["policy"], session.phase) == (0, Phase.PLAYING)  # the next episode
    return Dataset.open(record)[0]


def test_an_intervention_is_recorded_as_such(tmp_path: Path) -> None:
    stored = intervened(tmp_path)
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


def test_only_episodes_in_which_a_person_acted_are_kept(tmp_path: Path) -> None:
    session = watched(tmp_path)
    session.finish()
    assert (session.phase, session.can_keep) == (Phase.ENDED, False)
    for message in (Keep("Ada"), Press("discard")):
        session.send(message)
        assert "no finished episode" in session.notice
    session.send(Press("restart"))
    assert (session.phase, session.status()["policy_acts"]) == (Phase.PLAYING, True)


def test_a_paused_policy_goes_on_when_it_is_handed_back_to() -> None:
    session = watched()
    session.step(2)
    session.send(Press("pause"))
    steps = session.episode.steps
    session.step(3)
    assert (session.phase, session.episode.steps) == (Phase.PAUSED, steps)
    session.send(Press("hand_back"))
    session.step(3)
    assert session.episode.steps >= steps + 3


def test_the_environment_waits_for_a_slow_policy_and_late_answers_have_no_effect() -> None:
    session = Clocked()
    session.handle(Start(ENV, 3, 0), session.now)
    question = session.take_question()
    assert question is not None
    assert session.take_question() is None  # asked once for each state
    for _ in range(round(2 * SILENCE_TIME / STEP_TIME)):
        session.now += STEP_TIME
        session.advance(session.now)
    assert (session.episode.steps, session.phase) == (0, Phase.PLAYING)
    session.handle(Press("restart"), session.now)
    question.ask()
    session.advance(session.now + STEP_TIME)
    assert session.episode.steps == 0
    session.send(Press("pause"))  # which asks the new one
    session.send(Press("resume"))
    session.step(1)
    assert session.episode.steps == 1


def test_no_policy_is_playing_again_and_an_unknown_one_changes_nothing() -> None:
    session = watched()
    session.step(2)
    session.send(Start(ENV, 3, 1))
    assert session.notice == "policy: expected a number up to 0, found 1"
    assert (session.status()["policy"], session.episode.steps) == (0, 2)
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


def test_the_episodes_of_a_dataset_are_listed_newest_first(demos: Path) -> None:
    session = Clocked(datasets=(demos,))
    session.handle(Watch(0, None), session.now)
    reply = str(session.take_update(session.now)[1])
    listed = json.loads(reply)["episodes"]
    assert [number for number, *_ in listed] == [1, 0]
    stored = Dataset.open(demos)[1]
    assert listed[0][1:] == ["MoveToRegion", "Demo", stored.score, "expert", 2]
    for message in (Watch(1, None), Watch(1, 0), Watch(0, 2)):
        session.send(message)
        assert "expected one of" in session.notice
    assert isinstance(session.episode, PlayedEpisode)


def test_a_recorded_episode_plays_stops_and_is_sought(demos: Path) -> None:
    session = Clocked(datasets=(demos,))
    session.send(Seek(1))
    assert "expected a recorded episode" in session.notice
    session.send(Watch(0, 1))
    session.step(2, LEFT)  # keys have no effect
    assert (session.episode.seed, session.episode.steps) == (2, 2)
    session.send(Seek(30))
    session.step(2)
    assert (session.episode.steps, session.phase) == (30, Phase.PAUSED)
    session.send(Press("resume"))
    session.finish()
    assert (session.episode.steps, session.phase, session.can_keep) == (40, Phase.ENDED, False)
    session.send(Seek(10**6))
    assert (session.episode.steps, session.phase) == (40, Phase.PAUSED)
    session.send(Press("restart"))
    session.send(Show("allo", 4.0))
    session.now = session.step_at
    session.hold()
    assert session.episode.steps == 1
    assert session.step_at - session.now == pytest.approx(STEP_TIME / 4)
    session.send(Start(ENV, 3, None))
    assert session.phase is Phase.READY


def test_who_acted_is_shown(tmp_path: Path) -> None:
    stored = intervened(tmp_path)
    assert stored.actors is not None
    session = Clocked(datasets=(tmp_path,))
    session.send(Watch(0, 0))
    for step in (1, int(np.argmax(stored.actors == Actor.HUMAN)) + 1):
        session.send(Seek(step))
        facts = session.status()["facts"]
        assert facts["Acted"] == Actor(int(stored.actors[step - 1])).name.lower()
        assert (facts["By"], facts["Policy"]) == ("Ada", "expert")
    assert facts["Acted"] == "human"


def test_a_damaged_dataset_is_said(tmp_path: Path) -> None:
    session = Clocked(datasets=(tmp_path / "none",))
    session.send(Watch(0, None))
    assert "none: expected a" in session.notice
    assert session.phase is Phase.READY
