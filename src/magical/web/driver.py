"""A policy that acts in a session's episode, or watches while a person acts."""

import threading
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from magical.demos.store.trajectory import Actor
from magical.envs.ids import EnvId
from magical.errors import MagicalError, PolicyError
from magical.evaluation.rollouts import observation_for
from magical.evaluation.seeds import RolloutRng
from magical.experts import EpisodeExpert, expert_for
from magical.observe import make_spec
from magical.scene import State
from magical.web.library.policies import Policies, act_on_one_thread, probabilities
from magical.web.library.rollouts import as_batch


@dataclass(frozen=True, slots=True)
class Proposal:
    """What a policy chooses in a state."""

    action: int
    probabilities: tuple[float, ...] | None = None  # (18,); None: it has none


@dataclass(frozen=True, slots=True)
class Seen:
    """A state of an episode, and the action that led to it."""

    state: State
    executed: int | None  # None: the first state


class Chooser(Protocol):
    """Chooses an action in every state of one episode, in their order."""

    def choose(self, seen: Seen) -> Proposal:
        """The action in the next state."""


class Driver:
    """Chooses actions in one episode.

    Nothing is loaded before the first call of `propose`, which may take seconds and is made in a
    thread. A state that is asked for again gets the same answer.

    Args:
        policies: the server's.
        number: of the policy.
        env_id: the episode's environment.
        seed: of the expert's strategy, and of sampling actions.

    Raises:
        NotFoundError: there is no such policy.
        PolicyError: it cannot act in this environment.
    """

    def __init__(self, policies: Policies, number: int, env_id: EnvId, seed: int) -> None:
        entry = policies.find(number)
        entry.check(env_id)
        self.number = number
        self.name = entry.name
        self.actor = Actor.EXPERT if entry.folder is None else Actor.POLICY
        self._policies, self._env_id, self._seed = policies, env_id, seed
        self._chooser: Chooser | None = None
        self._latest: tuple[int, Proposal] | None = None  # the step, and what was chosen in it
        self._lock = threading.Lock()

    def propose(self, seen: Seen) -> Proposal:
        """What the policy chooses in the next state of the episode.

        Raises:
            MagicalError: the policy cannot be loaded, or fails.
        """
        with self._lock:
            if self._latest is None or self._latest[0] != seen.state.step:
                self._latest = seen.state.step, self._choose(seen)
            return self._latest[1]

    def _choose(self, seen: Seen) -> Proposal:
        try:
            if self._chooser is None:
                self._chooser = self._make_chooser()
            return self._chooser.choose(seen)
        except MagicalError:
            raise
        except Exception as error:  # a policy may fail in any way, and the session goes on
            raise PolicyError(f"{self.name}: {type(error).__name__}: {error}") from error

    def _make_chooser(self) -> Chooser:
        if self.actor is Actor.EXPERT:
            return _ExpertChooser(self._env_id, self._seed)
        return _NetworkChooser(self._policies.load(self.number), self._env_id, self._seed)


class _ExpertChooser:
    def __init__(self, env_id: EnvId, seed: int) -> None:
        self._expert = EpisodeExpert(expert_for(env_id.task, seed=seed))

    def choose(self, seen: Seen) -> Proposal:
        if seen.executed is not None:
            self._expert.note_executed(seen.executed)
        return Proposal(self._expert.act(seen.state))


class _NetworkChooser:
    def __init__(self, policy: Any, env_id: EnvId, seed: int) -> None:
        self._policy = policy
        self._env_ids = [env_id]
        spec = make_spec(observation_for(policy), env_id.task_spec)
        self._observer = spec.observer()
        self._rng = RolloutRng(self._env_ids, [seed])
        policy.reset(np.ones(1, np.bool_))

    def choose(self, seen: Seen) -> Proposal:
        bodies = np.hstack([seen.state.poses.bodies, seen.state.velocities])
        if seen.executed is None:
            self._observer.start(seen.state.scene, bodies)
        else:
            self._observer.update(bodies)
        observation = as_batch(self._observer.out)
        action = act_on_one_thread(self._policy, observation, self._env_ids, self._rng)
        (row,) = probabilities(self._policy, observation, self._env_ids).round(3).tolist()
        return Proposal(action, tuple(row))
