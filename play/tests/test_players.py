"""Sessions: how many, lost connections, resuming, with time that is passed in."""

from functools import partial

import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.keys import Control
from magical_play.messages import Keys
from magical_play.players import RESUME_TIME, Player, Players
from magical_play.policies import Policies
from magical_play.session import Phase, Session

ENV = EnvId("MoveToRegion", "Demo")


@pytest.fixture
def players() -> Players:
    rng = np.random.default_rng(0)
    return Players(partial(Session, ENV, rng, Policies(), True), limit=2)


def playing(players: Players, now: float) -> tuple[Player, int]:
    """A player who has made one step, and the number of the connection."""
    player = players.find_or_add(None, now)
    connection = player.connect(now)
    player.session.handle(Keys(frozenset({Control.FORWARD}), 0), now)
    player.session.advance(now)
    return player, connection


def test_a_lost_connection_pauses_and_can_be_resumed(players: Players) -> None:
    player, connection = playing(players, 0.0)
    player.disconnect(connection, 1.0)
    assert player.session.phase is Phase.PAUSED
    resumed = players.find_or_add(player.key, 1.0 + RESUME_TIME)
    assert resumed is player
    resumed.connect(1.0 + RESUME_TIME)
    assert (player.session.phase, player.session.episode.steps) == (Phase.PAUSED, 1)
    player.session.handle(Keys(frozenset({Control.FORWARD}), 0), 100.0)
    player.session.advance(100.0)
    assert (player.session.phase, player.session.episode.steps) == (Phase.PLAYING, 2)
    players.drop_expired(1000.0)
    assert len(players) == 1


def test_after_a_minute_the_episode_is_dropped(players: Players) -> None:
    player, connection = playing(players, 0.0)
    player.disconnect(connection, 1.0)
    other = players.find_or_add(player.key, 1.1 + RESUME_TIME)
    assert other is not player
    assert (other.session.phase, other.session.episode.steps) == (Phase.READY, 0)
    assert len(players) == 1


def test_a_session_that_was_never_connected_is_dropped(players: Players) -> None:
    players.find_or_add(None, 0.0)
    players.drop_expired(1.0 + RESUME_TIME)
    assert not len(players)


def test_an_episode_that_is_being_stored_is_not_dropped(players: Players) -> None:
    player, connection = playing(players, 0.0)
    player.session.phase = Phase.SAVING
    player.disconnect(connection, 1.0)
    players.drop_expired(1000.0)
    assert len(players) == 1
    player.session.stored()
    players.drop_expired(1000.0)
    assert len(players) == 0
