"""Storing the episodes of all players in one dataset, beside the event loop."""

import asyncio
from pathlib import Path

from magical.demos.store.trajectory import Trajectory
from magical.demos.store.writer import DatasetWriter
from magical.errors import MagicalError
from magical.web.session import Session


class Recorder:
    """Appends episodes to a dataset, which is created if there is none.

    Raises:
        DatasetError: the folder holds something else or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._writer = DatasetWriter(folder)
        self._tasks: set[asyncio.Task[None]] = set()

    def store(self, session: Session, trajectory: Trajectory) -> asyncio.Task[None]:
        """Start to store an episode in a thread; in the end the session is told how it went.

        The loss of a connection does not stop it.
        """
        task = asyncio.get_running_loop().create_task(self._store(session, trajectory))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def finish(self) -> None:
        """Wait until everything is stored."""
        await asyncio.gather(*self._tasks)

    async def _store(self, session: Session, trajectory: Trajectory) -> None:
        try:
            await asyncio.to_thread(self._writer.append, trajectory)
        except MagicalError as error:
            session.not_stored(f"Not kept: {error}")
        else:
            session.stored()
