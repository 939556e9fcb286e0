"""The session of a server: what is played or watched, its clock, who acts, what is recorded.

Time is passed in, in seconds of any monotonic clock; nothing here waits or knows about sockets.
"""

import json
import traceback
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from magical import TASKS, get_task
from magical.demos import Actor, Dataset, DatasetWriter
from magical.envs import EnvId, parse_env_id
from magical.envs.keys import Control, action_of
from magical.envs.seeds import sample_training_seeds
from magical.errors import MagicalError
from magical.scene.constants import CONTROL_RATE
from magical_play import messages
from magical_play.episodes import PlayedEpisode, RecordedEpisode, in_words, joined
from magical_play.messages import Message, MessageError
from magical_play.policies import Driver, Policies

STEP_TIME = 1.0 / CONTROL_RATE  # s
POLL_TIME = STEP_TIME / 8  # s between checks whether the policy has chosen its action
SILENCE_TIME = 2.0  # s without a message from the page, after which a running episode is paused
MAX_UNSEEN = 4  # unconfirmed frames, beyond which no more are sent


class Phase(StrEnum):
    """What a session is waiting for."""

    READY = "ready"  # the first key of an episode
    PLAYING = "playing"  # the clock
    PAUSED = "paused"  # any key, or to be resumed
    ENDED = "ended"  # to keep or discard, if the episode can be kept; or the next one


class Session:
    """One person's environment or recorded episode, driven by messages and by the clock.

    The environment steps at 8 Hz from the first key press to the horizon. A key that was pressed
    and released between two steps counts for the next one. A watched policy acts from the start
    until a key is pressed, and again after control is handed back to it.

    It starts in `env_id`, offers policies and the episodes of datasets, and stores with `writer`.
    """

    def __init__(
        self,
        env_id: EnvId,
        policies: Policies,
        datasets: Sequence[Path] = (),
        writer: DatasetWriter | None = None,
    ) -> None:
        self.phase = Phase.READY
        self.view = "allo"
        self.notice = ""  # says what went wrong
        self.kept = 0  # number of stored episodes
        self.step_at = 0.0  # when `advance` should be called next
        self._policies, self._datasets, self._writer = policies, datasets, writer
        self._rng = np.random.default_rng()  # samples the seeds of scenes
        self._tasks = tuple(dict.fromkeys((*TASKS, env_id.task)))  # that the page offers
        self._seed: int | None = None  # of the episodes; None: each has another
        self._speed = 1.0  # of watched episodes
        self._held: frozenset[Control] = frozenset()
        self._pressed: frozenset[Control] = frozenset()  # since the last step
        self.changes = 0  # counts changes that the page should show; also the frame number
        self._shown = -1  # the change that was sent last
        self._unseen: deque[int] = deque()  # frames that were sent but not confirmed
        self._heard_at = 0.0  # when the page spoke last, or got a frame while all were confirmed
        self._replies: list[Mapping[str, Any]] = []  # to be sent before the next frame
        self._begin(env_id, None, None)

    # The page

    def joined(self) -> None:
        """Note that a page has connected: no keys are held; a running episode is paused."""
        self._held = frozenset()
        self._unseen.clear()
        self._replies = [self._offer()]
        self.pause()
        self.changes += 1

    def pause(self, notice: str = "") -> None:
        """Stop the clock of a running episode, and say why."""
        self._pressed = frozenset()
        if self.phase is Phase.PLAYING:
            self.phase, self.notice = Phase.PAUSED, notice
            self.changes += 1

    def note_problem(self, error: Exception) -> None:
        """Say what went wrong; what is not an error of ours is shown in the terminal too."""
        self.notice = str(error)
        if not isinstance(error, MagicalError):
            traceback.print_exception(error)
            self.notice = f"{type(error).__name__}: {error}"
        self.changes += 1

    def take_update(self, now: float) -> list[str | bytes]:
        """What to send now: replies as JSON, and status and frame if something has changed.

        The page confirms each frame. On a slow connection it gets fewer frames, always the newest,
        rather than a growing queue.
        """
        update: list[str | bytes] = [json.dumps(reply) for reply in self._replies]
        self._replies = []
        if self.changes != self._shown and len(self._unseen) < MAX_UNSEEN:
            self._heard_at = self._heard_at if self._unseen else now
            self._shown = self.changes
            self._unseen.append(self.changes)
            update += [json.dumps(self.status()), self.episode.frame(self.view)]
        return update

    def handle(self, message: Message, now: float) -> None:
        """Do what a message asks for, or note why that cannot be done."""
        self._heard_at = now
        if isinstance(message, messages.Keys):
            while self._unseen and self._unseen[0] <= message.seen:
                self._unseen.popleft()
            self._hold(message.held, now)
        else:
            self.notice = ""
            self._attempt(lambda: self._follow(message))
            self.changes += 1
        self.advance(now)

    def _attempt(self, work: Callable[[], None]) -> None:
        """Do what may fail in any way, as a user's task may; the session goes on."""
        try:
            work()
        except Exception as error:
            self.pause()
            self.note_problem(error)

    def _follow(self, message: Message) -> None:
        match message:
            case messages.Start(env_id, seed, policy):
                self._require_decision()
                self._begin(parse_env_id(env_id), seed, policy)
                self._seed = seed
            case messages.Press("pause"):
                self.pause()
            case messages.Press(button):
                getattr(self, f"_{button}")()
            case messages.Show(view, speed):
                self.view, self._speed = view, speed
            case messages.Keep(demonstrator):
                self._keep(demonstrator)
            case messages.Watch(dataset, episode):
                self._watch(dataset, episode)
            case messages.Seek(step):
                self._seek(step)

    # The other buttons of `Press`

    def _restart(self) -> None:
        self._require_decision()
        if isinstance(self.episode, PlayedEpisode):
            self._begin(self.episode.env_id, self.episode.seed, self._policy)
        else:
            self.episode.steps, self.phase = 0, Phase.PLAYING

    def _resume(self) -> None:
        if self.phase is Phase.PAUSED:
            self.phase = Phase.PLAYING

    def _discard(self) -> None:
        self._require_finished("discard")
        self._begin(self.episode.env_id, self._seed, self._policy)

    def _hand_back(self) -> None:
        if self._driver is None or self.phase is Phase.ENDED:
            raise MessageError("hand back: there is no policy to hand back to")
        self._policy_acts = True
        self._pressed = frozenset()
        self.phase = Phase.PLAYING

    # Playing, and watching a policy

    def _begin(self, env_id: EnvId, seed: int | None, policy: int | None) -> None:
        """Begin an episode: at once with a policy, otherwise at the first key press."""
        chosen = sample_training_seeds(self._rng, 1)[0] if seed is None else seed
        episode = PlayedEpisode(env_id, chosen)
        driver = None if policy is None else self._policies.driver(policy, episode)
        self.episode: PlayedEpisode | RecordedEpisode = episode
        self._driver, self._policy = driver, policy
        self._policy_acts = driver is not None
        self._pressed = frozenset()
        self.phase = Phase.READY if driver is None else Phase.PLAYING

    def _hold(self, held: frozenset[Control], now: float) -> None:
        new, self._held = held - self._held, held
        if not new or isinstance(self.episode, RecordedEpisode):
            return
        self._pressed |= new
        self._policy_acts = False
        if self.phase in (Phase.READY, Phase.PAUSED):
            self.phase, self.notice = Phase.PLAYING, ""
            self.step_at = now
        self.changes += 1

    def take_question(self) -> Driver | None:
        """The policy to be asked now, which is once in each state and may take long."""
        driver = self._driver
        if driver is None or driver.is_asked or self.phase is Phase.ENDED:
            return None
        driver.is_asked = True
        return driver

    # Watching recorded episodes

    def _watch(self, dataset: int, number: int | None) -> None:
        if dataset >= len(self._datasets):
            raise MessageError(f"expected one of {len(self._datasets)} datasets, found {dataset}")
        found = Dataset.open(self._datasets[dataset])
        if number is None:
            listed = [
                (i, e.env_id.task, e.env_id.variant, e.final_score, e.demonstrator, e.seed)
                for i, e in enumerate(found.entries)
            ]
            self._replies += [{"type": "episodes", "dataset": dataset, "episodes": listed[::-1]}]
            return
        self._require_decision()
        if number >= len(found):
            raise MessageError(f"expected one of {len(found)} episodes, found number {number}")
        self.episode, self._driver = RecordedEpisode(found[number]), None
        self.phase, self._policy = Phase.PLAYING, None

    def _seek(self, step: int) -> None:
        if isinstance(self.episode, PlayedEpisode):
            raise MessageError("seek: expected a recorded episode, found one that is played")
        self.episode.steps = min(step, self.episode.length)
        self.phase = Phase.PAUSED

    # Recording

    @property
    def can_keep(self) -> bool:
        """Whether the episode can be kept or discarded: it has ended, and a person has acted."""
        played = isinstance(self.episode, PlayedEpisode) and Actor.HUMAN in self.episode.actors
        return played and self._writer is not None and self.phase is Phase.ENDED

    def _require_decision(self) -> None:
        if self.can_keep:
            raise MessageError("keep or discard this episode first")

    def _require_finished(self, what: str) -> None:
        if not self.can_keep:
            raise MessageError(f"{what}: there is no finished episode to {what}")

    def _keep(self, demonstrator: str) -> None:
        self._require_finished("keep")
        assert isinstance(self.episode, PlayedEpisode)
        assert self._writer is not None
        policy = self._driver.name if self._driver else None
        self._writer.append(self.episode.trajectory(demonstrator, self.view, policy))
        self.kept += 1
        self._begin(self.episode.env_id, self._seed, self._policy)

    # The clock

    def advance(self, now: float) -> None:
        """Step if a step is due; pause the episode if the page has gone silent.

        After a delay, missed steps are not caught up: no player could have seen them.
        """
        step_time = STEP_TIME / (self._speed if isinstance(self.episode, RecordedEpisode) else 1)
        if self.phase is not Phase.PLAYING:
            self.step_at = now + step_time
        elif now >= self.step_at:
            if self._unseen and now - self._heard_at > SILENCE_TIME:
                self.pause("Paused: the page did not respond.")
            elif self._driver and self._driver.error:
                error = self._driver.error
                self._begin(self.episode.env_id, self.episode.seed, None)
                self.note_problem(error)
            elif self._driver and self._driver.choice is None:
                self.step_at = now + POLL_TIME
            else:
                late = now - self.step_at > step_time
                self.step_at = step_time + (now if late else self.step_at)
                self._attempt(self._step)
                self.changes += 1

    def _step(self) -> None:
        episode, driver = self.episode, self._driver
        if isinstance(episode, RecordedEpisode):
            episode.steps = min(episode.steps + 1, episode.length)
        else:
            action, actor, choice = action_of(self._held | self._pressed), Actor.HUMAN, None
            self._pressed = frozenset()
            if driver is not None:
                choice, driver.choice, driver.is_asked = driver.choice, None, False
                if self._policy_acts and choice is not None:
                    action, actor = choice, driver.actor
            episode.act(action, actor, choice)
        if episode.steps == episode.length:
            self.phase = Phase.ENDED

    # What the page shows

    def _offer(self) -> Mapping[str, Any]:
        variants = {name: get_task(name).variants for name in self._tasks}
        return {
            "type": "offer",
            "tasks": {t: {v: EnvId(t, v) for v in names} for t, names in variants.items()},
            "policies": self._policies.names(),
            "datasets": list(map(str, self._datasets)),
        }

    def status(self) -> dict[str, Any]:
        """The session's state as plain JSON data."""
        episode, driver = self.episode, self._driver
        choice = None if driver is None or driver.choice is None else in_words(driver.choice)
        return {
            "type": "status",
            "number": self.changes,
            "phase": self.phase,
            "is_recorded": isinstance(episode, RecordedEpisode),
            "env_id": episode.env_id,
            "task": episode.env_id.task,
            "variant": episode.env_id.variant,
            "seed": episode.seed,
            "goal": episode.env_id.task_spec.instruction(episode.scene),
            "view": self.view,
            "steps": episode.steps,
            "length": episode.length,
            "facts": episode.facts(),
            "executed": episode.executed or [],
            "recording": self._writer is not None,
            "can_keep": self.can_keep,
            "kept": self.kept,
            "notice": self.notice,
            "policy": self._policy,
            "policy_name": driver.name if driver else None,
            "policy_acts": self._policy_acts,
            "proposed": joined(choice),
        }
