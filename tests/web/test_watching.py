"""Watching a policy, taking over from it and handing back; what of it is recorded."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos import Actor, Dataset, DatasetWriter
from magical.demos.summary import replay
from magical.envs.keys import controls_of
from magical.errors import MessageError, NotFoundError
from magical.experts import rollout
from magical.web import driver as driver_module
from magical.web.driver import Driver
from magical.web.messages import (
    Discard,
    HandBack,
    Keep,
    Pause,
    Restart,
    Watch,
)
from magical.web.session import SILENCE_TIME, STEP_TIME, Phase
from tests.web.clocked import GRIP, LEFT, watched
from tests.web.serving import RunningServer


def test_a_watched_policy_acts_from_the_start_as_it_would_alone() -> None:
    clocked = watched()
    assert (clocked.status["phase"], clocked.status["policy_acts"]) == ("playing", True)
    clocked.finish()
    actions = clocked.session.episode.env.get_state()["actions"]
    assert actions == rollout("MoveToRegion", "Demo", 3).actions.tolist()
    assert clocked.status["score"] == 1.0


def test_a_key_takes_over_and_the_policy_goes_on_when_it_is_handed_back_to() -> None:
    clocked = watched()
    clocked.step(3)
    clocked.step(4, LEFT)
    assert clocked.status["policy_acts"] is False
    assert clocked.status["executed"] == (LEFT,)
    clocked.step(2)  # no key: still the person's turn
    assert clocked.status["executed"] == ()
    clocked.send(HandBack())
    assert clocked.status["policy_acts"] is True
    clocked.finish()
    actors = clocked.session.episode.actors
    taken = [step for step, actor in enumerate(actors) if actor is Actor.HUMAN]
    assert taken == list(range(taken[0], taken[0] + 6))
    assert set(actors) == {Actor.EXPERT, Actor.HUMAN}
    assert clocked.status["score"] == 1.0  # the expert recovered from where it was led


def test_an_intervention_is_recorded_as_such(tmp_path: Path) -> None:
    clocked = watched(recording=True)
    clocked.step(3)
    clocked.step(5, LEFT, GRIP)
    clocked.send(HandBack())
    clocked.finish()
    clocked.send(Keep("Ada"))
    found = clocked.session.take_pending()
    assert found is not None
    DatasetWriter(tmp_path).append(found)
    (stored,) = Dataset.open(tmp_path)
    human = stored.actors == Actor.HUMAN
    assert human.sum() == 5
    assert {controls_of(action) for action in stored.actions[human].tolist()} == {(LEFT, GRIP)}
    np.testing.assert_array_equal(stored.actions[~human], stored.policy_actions[~human])
    assert (stored.actions[human] != stored.policy_actions[human]).any()
    np.testing.assert_array_equal(stored.labels, stored.actions)
    assert stored.is_demonstrated.all()  # the expert and the person are demonstrators both
    assert (stored.demonstrator, stored.metadata["policy"]) == ("Ada", "expert")
    assert replay(stored).departure == 0.0


def test_only_episodes_in_which_a_person_acted_are_kept() -> None:
    clocked = watched(recording=True)
    clocked.finish()
    assert (clocked.status["phase"], clocked.status["can_keep"]) == ("ended", False)
    for message in (Keep("Ada"), Discard()):
        with pytest.raises(MessageError, match="no finished episode"):
            clocked.send(message)
    clocked.send(Restart())
    assert (clocked.status["phase"], clocked.status["policy_acts"]) == ("playing", True)


def test_a_paused_policy_goes_on_when_it_is_handed_back_to() -> None:
    clocked = watched()
    clocked.step(2)
    clocked.send(Pause())
    steps = clocked.session.episode.steps
    clocked.step(3)
    assert (clocked.status["phase"], clocked.session.episode.steps) == ("paused", steps)
    clocked.send(HandBack())
    clocked.step(3)
    assert (clocked.status["phase"], clocked.status["policy_acts"]) == ("playing", True)
    assert clocked.session.episode.steps >= steps + 3


def test_the_environment_waits_for_a_slow_policy_and_late_answers_have_no_effect() -> None:
    clocked = watched()
    session = clocked.session
    clocked.step(2)
    question = session.take_question()
    assert question is not None
    assert session.take_question() is None  # asked once for each state
    steps = session.episode.steps
    for _ in range(round(2 * SILENCE_TIME / STEP_TIME)):
        clocked.now += STEP_TIME
        session.advance(clocked.now)
    assert (session.episode.steps, session.phase) == (steps, Phase.PLAYING)
    session.handle(Restart(), clocked.now)
    session.note_proposal(question, question.answer())
    session.advance(clocked.now + STEP_TIME)
    assert session.episode.steps == 0


def test_a_state_is_asked_for_again_after_a_lost_connection() -> None:
    clocked = watched()
    clocked.step(2)
    lost = clocked.session.take_question()
    assert lost is not None
    clocked.session.joined(clocked.now)
    again = clocked.session.take_question()
    assert again is not None
    assert again.answer() == lost.answer()


def test_an_unknown_policy_changes_nothing_and_none_is_playing_again() -> None:
    clocked = watched()
    clocked.step(2)
    with pytest.raises(NotFoundError, match="policy"):
        clocked.send(Watch(1))
    assert (clocked.status["policy"], clocked.session.episode.steps > 0) == (0, True)
    clocked.send(Watch(None))
    assert (clocked.status["policy"], clocked.status["phase"]) == (None, "ready")
    with pytest.raises(MessageError, match="no policy to hand back to"):
        clocked.send(HandBack())


def test_a_policy_that_fails_leaves_the_environment_to_the_person() -> None:
    clocked = watched()
    clocked.session.joined(clocked.now)
    question = clocked.session.take_question()
    assert question is not None
    clocked.session.note_failure(question, "no checkpoint")
    assert (clocked.status["policy"], clocked.status["phase"]) == (None, "ready")
    assert (clocked.status["notice"], clocked.status["seed"]) == ("no checkpoint", 3)


# Over real connections


def test_a_policy_that_cannot_be_loaded_is_said(
    server: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise OSError("the weights are gone")

    monkeypatch.setattr(driver_module, "expert_for", fail)
    with server.player() as player:
        player.send(type="watch", policy=0)
        status = player.wait_for(lambda status: "the weights are gone" in status["notice"])
        assert (status["policy"], status["phase"]) == (None, "ready")


def test_a_slow_policy_does_not_hold_up_other_players(
    server: RunningServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    release = threading.Event()
    propose = Driver.propose

    def slow(self: Driver, *seen: Any) -> Any:
        assert release.wait(60)
        return propose(self, *seen)

    monkeypatch.setattr(Driver, "propose", slow)
    with server.player() as watching, server.player() as playing:
        watching.send(type="watch", policy=0)
        watching.wait_for(lambda status: status["policy"] == 0)
        playing.hold("forward")
        playing.wait_for(lambda status: status["steps"] >= 5)
        assert watching.status["steps"] == 0
        release.set()
        watching.wait_for(lambda status: status["steps"] >= 2)
