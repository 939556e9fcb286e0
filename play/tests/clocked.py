"""A session with time that is passed in, played or watched without a server."""

from typing import Any

import numpy as np

from magical.envs import EnvId
from magical.envs.keys import Control
from magical_play.messages import Keys, Message, Start, Watch
from magical_play.policies import Policies
from magical_play.session import STEP_TIME, Phase, Session

ENV = EnvId("MoveToRegion", "Demo")
FORWARD, LEFT, GRIP = Control.FORWARD, Control.LEFT, Control.GRIP


class Clocked:
    """A session with a clock of its own, whose page confirms every frame.

    A policy that is watched answers at once.
    """

    def __init__(self, env_id: EnvId = ENV, *, recording: bool = False) -> None:
        self.now = 1000.0
        self.session = Session(env_id, np.random.default_rng(0), Policies(), recording, self.now)
        self.session.joined(self.now)

    def send(self, message: Message) -> None:
        self.session.handle(message, self.now)
        if question := self.session.take_question():
            self.session.note_proposal(question, question.answer())
        self.session.advance(self.now)

    def hold(self, *held: Control) -> None:
        self.send(Keys(frozenset(held), 0))

    def wait(self, seconds: float, *held: Control) -> None:
        """Let time pass while these controls are held."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now = min(end, max(self.session.step_at, self.now + 1e-3))
            self.hold(*held)

    def step(self, count: int, *held: Control) -> None:
        for _ in range(count):
            self.now += STEP_TIME
            self.hold(*held)

    def finish(self) -> None:
        while self.session.phase is Phase.PLAYING:
            self.step(1)

    @property
    def phase(self) -> str:
        return str(self.session.phase)

    @property
    def steps(self) -> int:
        return self.session.episode.steps

    @property
    def status(self) -> dict[str, Any]:
        return self.session.status()


def watched(*, recording: bool = False) -> Clocked:
    """A session that watches the expert in the scene of seed 3."""
    clocked = Clocked(recording=recording)
    clocked.send(Start(ENV, 3))
    clocked.send(Watch(0))
    return clocked
