"""All sessions of a server: a limited number, each dropped a minute after losing its connection."""

import secrets
from collections.abc import Callable, Iterator

from magical.errors import BusyError
from magical_play.session import Phase, Session

RESUME_TIME = 60.0  # s for which a session is kept after its connection was lost
KEY_BYTES = 16  # random bytes in the key that resumes a session


class Player:
    """A session with its key and the connection that owns it."""

    def __init__(self, key: str, session: Session, now: float) -> None:
        self.key = key
        self.session = session
        self._connections = 0  # number so far; the newest one owns the session
        self._left_at: float | None = now  # since when there is no connection; None: connected

    def connect(self, now: float) -> int:
        """Give the session to a new connection; returns the connection's number."""
        self._connections += 1
        self._left_at = None
        self.session.joined(now)
        return self._connections

    def owned_by(self, connection: int) -> bool:
        """Whether no newer connection has taken over the session."""
        return connection == self._connections

    def disconnect(self, connection: int, now: float) -> None:
        """Pause the episode; no effect for a connection that was replaced."""
        if self.owned_by(connection):
            self._left_at = now
            self.session.pause()

    def expired(self, now: float) -> bool:
        """Whether the connection was lost more than `RESUME_TIME` ago; never while saving."""
        saving = self.session.phase is Phase.SAVING
        return not saving and self._left_at is not None and now - self._left_at > RESUME_TIME


class Players:
    """The players of a server.

    Args:
        make_session: makes a session, given the current time.
        limit: the maximum number of sessions, including those that lost their connection and can
            still be resumed.
    """

    def __init__(self, make_session: Callable[[float], Session], limit: int) -> None:
        self._make_session = make_session
        self._limit = limit
        self._players: dict[str, Player] = {}

    def __len__(self) -> int:
        return len(self._players)

    def __iter__(self) -> Iterator[Player]:
        return iter(self._players.values())

    def find_or_add(self, key: str | None, now: float) -> Player:
        """The player with that key, or a new player.

        Raises:
            BusyError: there is no such player, and the server is full.
        """
        self.drop_expired(now)
        if key is not None and key in self._players:
            return self._players[key]
        if len(self._players) >= self._limit:
            raise BusyError(
                f"all {self._limit} environments of this server are in use; try again later, or "
                "ask for a larger --max-players"
            )
        player = Player(secrets.token_urlsafe(KEY_BYTES), self._make_session(now), now)
        self._players[player.key] = player
        return player

    def remove(self, player: Player) -> None:
        """Drop a session with its episode."""
        self._players.pop(player.key, None)

    def drop_expired(self, now: float) -> None:
        """Drop the sessions that were not resumed in time, with their episodes."""
        for player in [player for player in self if player.expired(now)]:
            self.remove(player)
