"""One player's session: an environment, its clock, and the episode being played.

Time is passed in, in seconds of any monotonic clock; nothing here waits, reads a clock or knows
about sockets.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from magical.demos.trajectory import Actor, Trajectory
from magical.envs.ids import EnvId, parse_env_id
from magical.envs.keys import Control, action_of, controls_of
from magical.envs.seeds import sample_training_seeds
from magical.errors import MessageError
from magical.scene import State
from magical.scene.constants import CONTROL_RATE
from magical.web import messages
from magical.web.driver import Driver, Proposal
from magical.web.episode import PlayedEpisode
from magical.web.frames import render_webp
from magical.web.messages import PAGE_VIEWS, Message
from magical.web.policies import Policies

STEP_TIME = 1.0 / CONTROL_RATE  # s
POLL_TIME = STEP_TIME / 8  # s between checks whether the policy has chosen its action
SILENCE_TIME = 2.0  # s without a message from the page, after which a running episode is paused
IDLE_TIME = 600.0  # s without a key or button press, after which a session ends


class Phase(StrEnum):
    """What a session is waiting for."""

    READY = "ready"  # the first key of an episode
    PLAYING = "playing"  # the clock
    PAUSED = "paused"  # any key, or `Resume`
    ENDED = "ended"  # to keep or discard; without recording, the next episode
    SAVING = "saving"  # the disk


@dataclass(frozen=True, slots=True)
class Question:
    """A request for a policy's action in the current state; to be answered in a thread."""

    driver: Driver
    state: State
    executed: int | None  # the action that led to the state

    def answer(self) -> Proposal:
        """Ask the policy; raises `MagicalError`."""
        return self.driver.propose(self.state, self.executed)


class Session:
    """One player's environment and episode, driven by messages and by the clock.

    The environment steps at 8 Hz from the first key press to the horizon. A key that was pressed
    and released between two steps counts for the next one.

    A watched policy acts from the start until a key is pressed, and again after control is handed
    back to it. It is asked in every state, whoever acts: the caller takes each `Question` from
    `take_question` and passes the answer to `note_proposal`.

    Args:
        env_id: the first environment.
        rng: samples the seeds of scenes.
        policies: the policies that can be watched.
        recording: whether episodes can be kept.
        now: the current time, in seconds.
    """

    def __init__(
        self,
        env_id: EnvId,
        rng: np.random.Generator,
        policies: Policies,
        recording: bool,
        now: float,
    ) -> None:
        self.recording = recording
        self.phase = Phase.READY
        self.view = "allo"
        self.notice = ""  # tells the player what went wrong
        self.kept = 0  # number of stored episodes
        self.changes = 0  # counts changes that the page should show; also the frame number
        self._rng = rng
        self._held: frozenset[Control] = frozenset()
        self._pressed: frozenset[Control] = frozenset()  # since the last step
        self.step_at = now  # when `advance` should be called next
        self._heard_at = now
        self._input_at = now
        self._fixed_seed = False  # whether the next episode has the same seed
        self._pending: Trajectory | None  # the episode to be stored
        self._policies = policies
        self._driver: Driver | None  # of the watched policy
        self._is_handed: bool  # whether the policy acts
        self._proposal: Proposal | None  # what it chooses in the current state
        self._asked: bool  # whether the proposal was asked for
        self._begin(env_id, None, None)

    def joined(self, now: float) -> None:
        """Note that a page has connected: no keys are held, and a running episode is paused."""
        self._held = frozenset()
        self._heard_at = self._input_at = now
        self._asked = False  # an answer may have been lost with the previous connection
        self.pause()
        self._changed()

    def pause(self) -> None:
        """Pause a running episode until the next key press."""
        self._pressed = frozenset()
        if self.phase is Phase.PLAYING:
            self.phase = Phase.PAUSED
            self._changed()

    def idle(self, now: float) -> bool:
        """Whether the player has done nothing for `IDLE_TIME`; never while an episode is saved."""
        return self.phase is not Phase.SAVING and now - self._input_at > IDLE_TIME

    # Messages

    def handle(self, message: Message, now: float) -> None:
        """Do what a message asks for.

        Raises:
            MessageError: the message is not allowed in the current phase; the episode is unchanged.
            MagicalError: an environment could not be started; the old one continues.
        """
        self._heard_at = now
        if isinstance(message, messages.Keys):
            self._hold(message.held, now)
            return
        self._input_at = now
        self._follow(message)
        if not isinstance(message, messages.Show):
            self.notice = ""
        self._changed()

    def _follow(self, message: Message) -> None:
        match message:
            case messages.Start(env_id, seed):
                self._require_decision()
                self._begin(parse_env_id(env_id), seed, self._policy)
                self._fixed_seed = seed is not None
            case messages.Restart():
                self._require_decision()
                self._begin(self.episode.env_id, self.episode.seed, self._policy)
            case messages.Pause():
                self.pause()
            case messages.Resume() if self.phase is Phase.PAUSED:
                self.phase = Phase.PLAYING
            case messages.Show(view):
                self.view = view
            case messages.Keep(demonstrator):
                self._require_finished("keep")
                policy = self._driver.name if self._driver else None
                self._pending = self.episode.trajectory(demonstrator, self.view, policy)
                self.phase = Phase.SAVING
            case messages.Discard():
                self._require_finished("discard")
                self._next_episode(self._policy)
            case messages.Watch(policy):
                self._require_decision()
                self._next_episode(policy)
            case messages.HandBack():
                self._hand_back()

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
        if started and self._is_handed:
            self._is_handed = False
            self._changed()
        if started and self.phase in (Phase.READY, Phase.PAUSED):
            self.phase = Phase.PLAYING
            self.notice = ""
            self.step_at = now
            self._changed()

    def _hand_back(self) -> None:
        if self._driver is None or self.phase in (Phase.ENDED, Phase.SAVING):
            raise MessageError("hand back: there is no policy to hand back to")
        self._is_handed = True
        self._pressed = frozenset()
        self.phase = Phase.PLAYING

    @property
    def can_keep(self) -> bool:
        """Whether the episode can be kept once it has ended: if recording and the player acted."""
        return self.recording and Actor.HUMAN in self.episode.actors

    def _require_decision(self) -> None:
        if self.phase is Phase.SAVING or (self.phase is Phase.ENDED and self.can_keep):
            raise MessageError("keep or discard this episode first")

    def _require_finished(self, what: str) -> None:
        if self.phase is not Phase.ENDED or not self.can_keep:
            raise MessageError(f"{what}: there is no finished episode to {what}")

    # The watched policy

    def take_question(self) -> Question | None:
        """The question to ask the policy now, once for each state; `None` if there is none."""
        if self._driver is None or self._asked or self.phase in (Phase.ENDED, Phase.SAVING):
            return None
        self._asked = True
        return Question(self._driver, *self.episode.seen)

    def note_proposal(self, question: Question, proposal: Proposal) -> None:
        """Note the answer to a question; a late answer has no effect."""
        if question.driver is self._driver and question.state.step == self.episode.steps:
            self._proposal = proposal
            self._changed()

    def note_failure(self, question: Question, problem: str) -> None:
        """Restart the episode without a policy that has failed."""
        if question.driver is self._driver:
            self._begin(self.episode.env_id, self.episode.seed, None)
            self.note_problem(problem)

    # Storing

    def take_pending(self) -> Trajectory | None:
        """The episode to be stored, returned once; call `stored` or `not_stored` afterwards."""
        pending, self._pending = self._pending, None
        return pending

    def stored(self) -> None:
        """Note that the pending episode is in the dataset, and start the next one."""
        self.kept += 1
        self._next_episode(self._policy)
        self._changed()

    def not_stored(self, problem: str) -> None:
        """Note that the pending episode was not stored; the player may retry or discard it."""
        self.phase = Phase.ENDED
        self.note_problem(problem)

    # The clock

    def advance(self, now: float) -> None:
        """Step the environment if a step is due; pause the episode if the page has gone silent.

        After a delay, missed steps are not caught up: the player could not have seen them.
        """
        if self.phase is not Phase.PLAYING:
            self.step_at = now + STEP_TIME
            return
        if now < self.step_at:
            return
        if self._driver is not None and self._proposal is None:
            # While waiting, no frame is sent that the page could confirm.
            self._heard_at += now - self.step_at + POLL_TIME
            self.step_at = now + POLL_TIME
            return
        if now - self._heard_at > SILENCE_TIME:
            self.pause()
            self.note_problem("Paused: the page did not respond.")
            return
        late = now - self.step_at > STEP_TIME
        self.step_at = STEP_TIME + (now if late else self.step_at)
        self._step()
        self._changed()

    def _step(self) -> None:
        held, self._pressed = self._held | self._pressed, frozenset()
        action, actor, chosen = action_of(held), Actor.HUMAN, None
        if self._driver is not None and self._proposal is not None:
            chosen = self._proposal.action
            if self._is_handed:
                action, actor = chosen, self._driver.actor
        if self.episode.step(action, actor, chosen):
            self.phase = Phase.ENDED
        self._proposal, self._asked = None, False

    # What the page shows

    def status(self) -> dict[str, Any]:
        """The session's state as plain JSON data."""
        episode, env = self.episode, self.episode.env
        driver, proposal, last = self._driver, self._proposal, episode.last_action
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
            "executed": None if last is None else controls_of(last),
            "recording": self.recording,
            "can_keep": self.can_keep,
            "kept": self.kept,
            "notice": self.notice,
            "policy": driver.number if driver else None,
            "policy_name": driver.name if driver else None,
            "policy_acts": self._is_handed,
            "proposed": controls_of(proposal.action) if proposal else None,
            "probabilities": proposal.probabilities if proposal else None,
        }

    def frame(self) -> bytes:
        """The current frame as a WebP file."""
        state = self.episode.env.state()
        return render_webp(state.scene, state.poses, PAGE_VIEWS[self.view])

    def _next_episode(self, policy: int | None) -> None:
        seed = self.episode.seed if self._fixed_seed else None
        self._begin(self.episode.env_id, seed, policy)

    @property
    def _policy(self) -> int | None:
        return self._driver.number if self._driver else None

    def _begin(self, env_id: EnvId, seed: int | None, policy: int | None) -> None:
        """Begin an episode: at once with a policy, otherwise at the first key press."""
        chosen = sample_training_seeds(self._rng, 1)[0] if seed is None else seed
        driver = None if policy is None else Driver(self._policies, policy, env_id, chosen)
        self.episode = PlayedEpisode(env_id, chosen)
        self._driver = driver
        self._is_handed = driver is not None
        self._proposal, self._asked = None, False
        self._pending = None
        self.phase = Phase.READY if driver is None else Phase.PLAYING
        self._pressed = frozenset()

    def _changed(self) -> None:
        self.changes += 1
