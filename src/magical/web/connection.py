"""A session over one WebSocket: messages in, status and frames out, driven by a clock.

A watched policy is called in a thread, so that its network or its planning does not hold up other
players.
"""

import asyncio
import json
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from enum import IntEnum
from time import monotonic

from starlette.websockets import WebSocket, WebSocketDisconnect

from magical.demos.trajectory import Trajectory
from magical.errors import MagicalError, MessageError
from magical.web.messages import Keys, parse_message
from magical.web.players import Player
from magical.web.security import RateLimit
from magical.web.session import Session

MESSAGE_RATE = 60.0  # messages per second; the page sends 8, plus two for each key press
MESSAGE_BURST = 120.0  # messages
COMMAND_RATE = 4.0  # messages per second other than keys: these start episodes, or render again
COMMAND_BURST = 8.0  # messages
FIRST_TIME = 30.0  # s within which the page must send its first message
MAX_UNSEEN = 4  # unconfirmed frames, beyond which no more are sent

Save = Callable[[Session, Trajectory], asyncio.Task[None]]


class Close(IntEnum):
    """Why a connection is closed, as the WebSocket's close code."""

    REPLACED = 4001  # the session was opened in another tab
    IDLE = 4002
    FULL = 4003
    SILENT = 4004  # no message arrived within `FIRST_TIME`; the page reconnects


class Connection:
    """One WebSocket that a player's page has opened.

    The page confirms each frame. On a slow connection it gets fewer frames, always the newest,
    rather than a growing queue.

    Args:
        socket: the accepted WebSocket.
        player: the player whose session is played.
        save: starts storing a session's episode; the task ends once the session knows the outcome.
        threads: runs the calls of policies.
    """

    def __init__(self, socket: WebSocket, player: Player, save: Save, threads: Executor) -> None:
        self._socket = socket
        self._player = player
        self._session = player.session
        self._save = save
        self._threads = threads
        self._unseen: deque[int] = deque()  # frames that were sent but not confirmed
        self._messages = RateLimit(MESSAGE_RATE, MESSAGE_BURST, monotonic())
        self._commands = RateLimit(COMMAND_RATE, COMMAND_BURST, monotonic())
        self._wake = asyncio.Event()  # there may be something to send
        self._step = asyncio.Event()  # there may be something to ask the policy

    async def run(self) -> Close | None:
        """Play until the connection ends; returns why it should be closed, if it is still open."""
        number = self._player.connect(monotonic())
        tasks = [
            asyncio.create_task(work)
            for work in (self._receive(), self._send(), self._run_clock(number), self._ask())
        ]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._player.disconnect(number, monotonic())
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        return next((task.result() for task in done if task.result() is not None), None)

    async def _receive(self) -> Close | None:
        try:
            async with asyncio.timeout(FIRST_TIME) as first:
                while (event := await self._socket.receive())["type"] != "websocket.disconnect":
                    first.reschedule(None)
                    if self._messages.allows(monotonic()):
                        self._handle(event.get("text"))
                    await asyncio.sleep(0)  # many messages at once must not block other players
        except TimeoutError:
            return Close.SILENT
        return None

    def _handle(self, text: str | None) -> None:
        try:
            message = parse_message(text or "")  # None: a binary message
        except MessageError:
            return  # the page sends no invalid messages, and replies would amplify a flood
        if isinstance(message, Keys):
            while self._unseen and self._unseen[0] <= message.seen:
                self._unseen.popleft()
        elif not self._commands.allows(monotonic()):
            return
        try:
            self._session.handle(message, monotonic())
        except MagicalError as error:
            self._session.note_problem(str(error))
        if trajectory := self._session.take_pending():
            self._save(self._session, trajectory).add_done_callback(lambda _: self._changed())
        self._session.advance(monotonic())
        self._changed()

    def _changed(self) -> None:
        self._wake.set()
        self._step.set()

    async def _ask(self) -> None:
        loop, session = asyncio.get_running_loop(), self._session
        while True:
            if question := session.take_question():
                try:
                    proposal = await loop.run_in_executor(self._threads, question.answer)
                except MagicalError as error:
                    session.note_failure(question, str(error))
                else:
                    session.note_proposal(question, proposal)
                self._wake.set()
            else:
                await self._step.wait()
                self._step.clear()

    async def _send(self) -> None:
        shown, session = None, self._session
        with suppress(WebSocketDisconnect):
            while True:
                if session.changes != shown and len(self._unseen) < MAX_UNSEEN:
                    shown = session.changes
                    status, frame = session.status(), session.frame()
                    self._unseen.append(shown)
                    await self._socket.send_text(json.dumps(status))
                    await self._socket.send_bytes(frame)
                await self._wake.wait()
                self._wake.clear()

    async def _run_clock(self, number: int) -> Close:
        while True:
            await asyncio.sleep(max(0.0, self._session.step_at - monotonic()))
            now = monotonic()
            if not self._player.owned_by(number):
                return Close.REPLACED
            if self._session.idle(now):
                return Close.IDLE
            self._session.advance(now)
            self._changed()
