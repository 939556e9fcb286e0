"""All sessions of a server: at most so many, resumed within a minute, dropped after it."""

import secrets
from collections.abc import Callable, Iterator

from magical.errors import ServerFullError
from magical.web.session import Phase, Session

RESUME_TIME = 60.0  # s that a session is kept after its connection was lost
KEY_BYTES = 16  # of randomness in the key that resumes a session


class Player:
    """A session with its key, and which connection it belongs to."""

    def __init__(self, key: str, session: Session) -> None:
        self.key = key
        self.session = session
        self._connections = 0  # so far; the newest one owns the session
        self._left_at: float | None = None  # None: connected

    def connect(self, now: float) -> int:
        """Give the session to a new connection; returns the connection's number."""
        self._connections += 1
        self._left_at = None
        self.session.joined(now)
        return self._connections

    def owned_by(self, connection: int) -> bool:
        """Whether no newer connection has taken over."""
        return connection == self._connections

    def disconnect(self, connection: int, now: float) -> None:
        """Pause the episode; a connection that was replaced has no effect."""
        if self.owned_by(connection):
            self._left_at = now
            self.session.pause()

    def expired(self, now: float) -> bool:
        """Whether the connection was lost more than `RESUME_TIME` ago."""
        saving = self.session.phase is Phase.SAVING
        return not saving and self._left_at is not None and now - self._left_at > RESUME_TIME


class Players:
    """The players of a server.

    Args:
        make_session: makes a session at the time it is given.
        limit: the largest number of sessions, including those whose connection was lost and that
            can still be resumed.
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
        """The player with that key, or a new one.

        Raises:
            ServerFullError: there is no such player, and no room for a new one.
        """
        self.drop_expired(now)
        if key is not None and key in self._players:
            return self._players[key]
        if len(self._players) >= self._limit:
            raise ServerFullError(
                f"all {self._limit} environments of this server are in use; try again later, or "
                "ask for a larger --max-players"
            )
        player = Player(secrets.token_urlsafe(KEY_BYTES), self._make_session(now))
        self._players[player.key] = player
        return player

    def remove(self, player: Player) -> None:
        """Drop a session with its episode."""
        self._players.pop(player.key, None)

    def drop_expired(self, now: float) -> None:
        """Drop the sessions that were not resumed in time, each with its whole episode."""
        for player in [player for player in self if player.expired(now)]:
            self.remove(player)
