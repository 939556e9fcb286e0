"""A policy that acts in an episode, watched by a player or not, and its action probabilities."""

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.reader import observations
from magical.demos.record import recorded_trajectory
from magical.demos.trajectory import Actor, Trajectory
from magical.envs.ids import EnvId
from magical.errors import MagicalError, PolicyError
from magical.evaluation.policy import observation_for
from magical.evaluation.seeds import RolloutRng
from magical.experts import EpisodeExpert, expert_for, strategy_seed
from magical.observe import make_spec
from magical.observe.arrays import map_arrays
from magical.scene import State
from magical.web.episode import RECORDER, PlayedEpisode
from magical.web.policies import Policies

BATCH = 32  # steps per batch when computing probabilities


@dataclass(frozen=True, slots=True)
class Proposal:
    """The action that a policy chooses in a state."""

    action: int
    probabilities: tuple[float, ...] | None = None  # (18,); None: the policy has none


# Called in every state of one episode, in order, with the action that led to it, if any.
Chooser = Callable[[State, int | None], Proposal]


class Driver:
    """Chooses actions in one episode.

    Nothing is loaded before the first call of `propose`, which may take seconds and should be made
    in a thread. A repeated call for the latest state returns the same proposal.

    Args:
        policies: the server's policies.
        number: the policy's number.
        env_id: the episode's environment.
        seed: seeds the expert's strategy, and the sampling of actions.

    Raises:
        NotFoundError: there is no policy with that number.
        PolicyError: the policy cannot act in this environment.
    """

    def __init__(self, policies: Policies, number: int, env_id: EnvId, seed: int) -> None:
        entry = policies.find(number)
        entry.check(env_id)
        self.number = number
        self.name = entry.name
        self.actor = Actor.EXPERT if entry.folder is None else Actor.POLICY
        self._policies, self._env_id, self._seed = policies, env_id, seed
        self._choose: Chooser | None = None
        self._latest: tuple[int, Proposal] | None = None  # the latest step and its proposal
        self._lock = threading.Lock()

    def propose(self, state: State, executed: int | None) -> Proposal:
        """The action that the policy chooses in the next state of the episode.

        Args:
            state: the state.
            executed: the action that led to it; `None` in the first state.

        Raises:
            MagicalError: the policy cannot be loaded, or fails.
        """
        with self._lock:
            if self._latest is None or self._latest[0] != state.step:
                try:
                    self._choose = self._choose or self._make_chooser()
                    self._latest = state.step, self._choose(state, executed)
                except MagicalError:
                    raise
                except Exception as error:  # a policy may fail in any way; the session goes on
                    raise PolicyError(f"{self.name}: {type(error).__name__}: {error}") from error
            return self._latest[1]

    def _make_chooser(self) -> Chooser:
        if self.actor is Actor.EXPERT:
            return _expert_chooser(self._env_id, self._seed)
        return _network_chooser(self._policies.load(self.number), self._env_id, self._seed)


def _expert_chooser(env_id: EnvId, seed: int) -> Chooser:
    expert = EpisodeExpert(expert_for(env_id.task, seed=strategy_seed(env_id.variant, seed)))

    def choose(state: State, executed: int | None) -> Proposal:
        if executed is not None:
            expert.note_executed(executed)
        return Proposal(expert.act(state))

    return choose


def _network_chooser(policy: Any, env_id: EnvId, seed: int) -> Chooser:
    observer = make_spec(observation_for(policy), env_id.task_spec).observer()
    rng = RolloutRng([env_id], [seed])
    policy.reset(np.ones(1, np.bool_))

    def choose(state: State, executed: int | None) -> Proposal:
        bodies = state.bodies
        if executed is None:
            observer.start(state.scene, bodies)
        else:
            observer.update(bodies)
        observations = map_arrays(lambda array: array[None], observer.out)
        with _one_thread():
            action = int(policy.act(observations, [env_id], rng)[0])
            if not hasattr(policy, "probabilities"):
                return Proposal(action)
            (row,) = policy.probabilities(observations, [env_id]).round(3).tolist()
        return Proposal(action, tuple(row))

    return choose


def _one_thread() -> AbstractContextManager[None]:
    """One thread is faster for single observations, and leaves the other cores to players."""
    from magical.learning.running.devices import cpu_threads  # imports PyTorch; only runs need it

    return cpu_threads(1)


def roll_out(policies: Policies, number: int, env_id: EnvId, seed: int) -> Trajectory:
    """Roll out a policy for one episode, in the scene of `reset(seed=seed)`.

    Actions are sampled as in evaluations. The trajectory's demonstrator is the policy's name.

    Raises:
        NotFoundError: there is no policy with that number.
        MagicalError: the policy cannot be loaded, or cannot act in the environment.
    """
    driver, episode = Driver(policies, number, env_id, seed), PlayedEpisode(env_id, seed)
    while not episode.step(driver.propose(*episode.seen).action, driver.actor):
        pass
    remarks = {"recorder": RECORDER, "policy": driver.name}
    return recorded_trajectory(
        episode.env, episode.bodies, seed=seed, demonstrator=driver.name, metadata=remarks
    )


def episode_probabilities(policy: Any, episode: Trajectory) -> NDArray[np.float64]:
    """A policy's distributions over actions before each step of an episode, (T, 18).

    Raises:
        PolicyError: the policy did not learn the episode's task, or has no probabilities of single
            actions.
        TrajectoryError, ObservationError: the episode lacks the policy's observations.
    """
    if not hasattr(policy, "probabilities"):
        raise PolicyError(
            "policy: expected one whose actions depend on the current observation alone, found one "
            "with a memory; watch it act instead"
        )
    steps = np.arange(len(episode))
    with _one_thread():
        parts = [
            policy.probabilities(
                observations(episode, policy.observation, times), [episode.env_id] * len(times)
            )
            for times in np.split(steps, steps[BATCH::BATCH])
        ]
    return np.concatenate(parts)
