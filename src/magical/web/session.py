"""One player's session: an environment, its clock, and the episode that is played.

Time is passed in, in seconds of any steady clock; nothing here waits, reads a clock or knows about
sockets.
"""

from enum import StrEnum
from typing import Any

import numpy as np

from magical.demos.store.trajectory import Trajectory
from magical.envs.ids import EnvId
from magical.envs.keys import Control, action_of
from magical.envs.seeds import sample_training_seeds
from magical.errors import MessageError
from magical.scene.constants import CONTROL_RATE
from magical.web.episode import PlayedEpisode
from magical.web.frames import FrameEncoder
from magical.web.messages import (
    VIEWS,
    Discard,
    Keep,
    Keys,
    Message,
    Pause,
    Restart,
    Show,
    Start,
)

STEP_TIME = 1.0 / CONTROL_RATE  # s
SILENCE_TIME = 2.0  # s without a message from the page, after which a running episode is paused
IDLE_TIME = 600.0  # s without a key or a button, after which a session ends


class Phase(StrEnum):
    """What a session waits for."""

    READY = "ready"  # the first key of an episode
    PLAYING = "playing"  # the clock
    PAUSED = "paused"  # any key
    ENDED = "ended"  # keep or discard; without recording, the next episode
    SAVING = "saving"  # the disk


class Session:
    """One player's environment and episode, driven by messages and by the clock.

    The environment steps at 8 Hz from the first key to the horizon. A key that was pressed and let
    go between two steps counts for the next one.

    Args:
        env_id: the first environment.
        rng: samples the seeds of scenes.
        now: the time, in seconds.
        recording: whether episodes can be kept.
    """

    def __init__(
        self, env_id: EnvId, rng: np.random.Generator, now: float, *, recording: bool = False
    ) -> None:
        self.recording = recording
        self.phase = Phase.READY
        self.view = "allo"
        self.notice = ""  # for the player: what went wrong
        self.kept = 0  # episodes stored
        self.changes = 0  # counts what the page should show; also the number of the frame
        self._rng = rng
        self._held: frozenset[Control] = frozenset()
        self._pressed: frozenset[Control] = frozenset()  # since the last step
        self._step_at = now
        self._heard_at = now
        self._input_at = now
        self._fixed_seed = False  # whether the next episode has the same seed
        self._pending: Trajectory | None = None  # the episode that is to be stored
        self._begin(env_id, None)

    def joined(self, now: float) -> None:
        """Note that a page was connected: it holds no keys, and a running episode is paused."""
        self._held = frozenset()
        self._heard_at = self._input_at = now
        self.pause()
        self._changed()

    def pause(self) -> None:
        """Stop a running episode until the next key."""
        self._pressed = frozenset()
        if self.phase is Phase.PLAYING:
            self.phase = Phase.PAUSED
            self._changed()

    def idle(self, now: float) -> bool:
        """Whether the player has done nothing for `IDLE_TIME`."""
        return self.phase is not Phase.SAVING and now - self._input_at > IDLE_TIME

    # Messages

    def handle(self, message: Message, now: float) -> None:
        """Do what a message asks for.

        Raises:
            MessageError: it cannot be followed now; nothing has changed.
            MagicalError: an environment could not be started; the old one goes on.
        """
        self._heard_at = now
        if isinstance(message, Keys):
            self._hold(message.held, now)
            return
        self._input_at = now
        self._follow(message)
        if not isinstance(message, Show):
            self.notice = ""
        self._changed()

    def _follow(self, message: Message) -> None:
        match message:
            case Start(env_id, seed):
                self._require_decision()
                self._begin(env_id, seed)
            case Restart():
                self._require_decision()
                self._begin(self.episode.env_id, self.episode.seed, fixed=self._fixed_seed)
            case Pause():
                self.pause()
            case Show(view):
                self.view = view
                self._new_encoder()
            case Keep(demonstrator):
                self._require(Phase.ENDED, "keep")
                self._pending = self.episode.trajectory(demonstrator, self.view)
                self.phase = Phase.SAVING
            case Discard():
                self._require(Phase.ENDED, "discard")
                self._next_episode()

    def note_problem(self, problem: str) -> None:
        """Tell the player what went wrong."""
        self.notice = problem
        self._changed()

    def _hold(self, held: frozenset[Control], now: float) -> None:
        if held != self._held:
            self._input_at = now
        self._pressed |= held - self._held
        started = bool(held - self._held)
        self._held = held
        if started and self.phase in (Phase.READY, Phase.PAUSED):
            self.phase = Phase.PLAYING
            self.notice = ""
            self._step_at = now
            self._changed()

    def _require_decision(self) -> None:
        if self.phase is Phase.SAVING or (self.phase is Phase.ENDED and self.recording):
            raise MessageError("keep or discard this episode first")

    def _require(self, phase: Phase, what: str) -> None:
        if self.phase is not phase or not self.recording:
            raise MessageError(f"{what}: there is no finished episode to {what}")

    # Storing

    def take_pending(self) -> Trajectory | None:
        """The episode to be stored, once: call `stored` or `not_stored` after that."""
        pending, self._pending = self._pending, None
        return pending

    def stored(self) -> None:
        """The pending episode is in the dataset: go on with the next one."""
        self.kept += 1
        self._next_episode()
        self._changed()

    def not_stored(self, problem: str) -> None:
        """The pending episode could not be stored; the player may try again, or discard it."""
        self.phase = Phase.ENDED
        self.note_problem(problem)

    # The clock

    @property
    def next_step(self) -> float:
        """When `advance` should be called next."""
        return self._step_at

    def advance(self, now: float) -> None:
        """Step the environment if a step is due; pause it if the page has fallen silent.

        After a delay no steps are made up for: the player could not have seen them.
        """
        if self.phase is not Phase.PLAYING:
            self._step_at = now + STEP_TIME
            return
        if now < self._step_at:
            return
        if now - self._heard_at > SILENCE_TIME:
            self.pause()
            self.note_problem("Paused: the page did not answer.")
            return
        late = now - self._step_at > STEP_TIME
        self._step_at = STEP_TIME + (now if late else self._step_at)
        held, self._pressed = self._held | self._pressed, frozenset()
        if self.episode.step(action_of(held)):
            self.phase = Phase.ENDED
        self._changed()

    # What the page shows

    def status(self) -> dict[str, Any]:
        """The session's state as plain JSON data."""
        episode, env = self.episode, self.episode.env
        return {
            "type": "status",
            "number": self.changes,
            "phase": self.phase,
            "env_id": episode.env_id,
            "task": episode.env_id.task,
            "variant": episode.env_id.variant,
            "seed": episode.seed,
            "view": self.view,
            "steps": episode.steps,
            "horizon": env.horizon,
            "seconds_left": (env.horizon - episode.steps) * STEP_TIME,
            "score": env.scores().score,
            "executed": episode.executed,
            "recording": self.recording,
            "kept": self.kept,
            "notice": self.notice,
        }

    def frame(self) -> bytes:
        """The present frame as a PNG file."""
        return self._encoder.png(self.episode.poses[-1])

    def _next_episode(self) -> None:
        self._begin(self.episode.env_id, self.episode.seed if self._fixed_seed else None)

    def _begin(self, env_id: EnvId, seed: int | None, fixed: bool | None = None) -> None:
        chosen = sample_training_seeds(self._rng, 1)[0] if seed is None else seed
        episode = PlayedEpisode(env_id, chosen)
        self._fixed_seed = seed is not None if fixed is None else fixed
        self.episode = episode
        self._pending = None
        self.phase = Phase.READY
        self._pressed = frozenset()
        self._new_encoder()

    def _new_encoder(self) -> None:
        scene = self.episode.env.state().scene
        self._encoder = FrameEncoder(scene, VIEWS[self.view])

    def _changed(self) -> None:
        self.changes += 1
