"""The protocol of policies, and simple policies."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.envs.action_spec import Actions as Actions
from magical.envs.action_spec import ActionSpec, action_spec
from magical.envs.vector import MagicalVectorEnv
from magical.errors import PolicyError
from magical.observe import STATE, Observation, make_spec
from magical.scene import NOOP, NUM_ACTIONS
from magical.tasks import Task

Mask = NDArray[np.bool_]  # (B,)

DEFAULT_OBSERVATION = "LoRes4E"
NO_OBSERVATION = "nothing"  # the observation of a policy that needs none


@runtime_checkable
class Policy(Protocol):
    """Chooses actions for a batch of B environments.

    A policy may also have these attributes; missing ones count as `False` or `None`:

    - `privileged` (bool): it gets true states; `observations` is then a list of B `State`s.
    - `observation`: the observation it was made for, as in `gymnasium.make(..., observation=...)`;
      `"nothing"` for a policy that needs none: `observations` is then `None`.
    - `action_space`: the action space it was made for, `"discrete"` (the default) or
      `"continuous"`; it is evaluated in environments with that action space.
    - `tasks` (sequence of names): the tasks it was made for.
    - `in_processes` (bool): copies of it may act in several processes; it can be pickled.
    - `modules(tasks)`: the modules that such processes must import first.
    - `updates` (two integers): the updates of its training that are done, and those planned.
    - `record` (mapping): the fields of `magical.evaluation.Record` that it states, such as
      `learned_from` and `training_seed`.
    - `using_threads(number)`: a context in which its network uses that many CPU threads.
    - `exact` (bool): its actions are the same on every machine, so `magical verify` expects equal
      scores wherever it runs. Those of a network are not.
    """

    def act(
        self, observations: Any, env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> NDArray[Any]:
        """Choose one action for each environment.

        Args:
            observations: a batch of observations, an array (B, ...) or a dict of such arrays; for
                a privileged policy a list of B `State`s. Valid during the call only: copy what
                you keep.
            env_ids: B environment ids without presets, for instance `magical/FindDupe-Demo-v0`:
                strings with the attributes `task` and `variant`.
            rng: the only source of randomness to use.

        Returns:
            Integers from 0 to 17, shape (B,); continuous actions: floats from -1 to 1, (B, 3).
        """

    def reset(self, mask: Mask) -> None:
        """Reset the memory of the environments where `mask` (B,) is true: they begin an episode.

        Called before the first `act`, with all true; the batch size may change then.
        """


def is_privileged(policy: Policy) -> bool:
    """Whether the policy gets true states instead of observations."""
    return bool(getattr(policy, "privileged", False))


def action_spec_of(policy: Policy) -> ActionSpec:
    """The action space of the environments that a policy acts in; raises `UnknownNameError`."""
    return action_spec(getattr(policy, "action_space", None) or "discrete")


def observation_for(policy: Policy, observation: Observation = None) -> Observation:
    """The observation to make environments with: the one given, the policy's own, or `LoRes4E`.

    Nothing is rendered for a policy that gets true states or needs no observation. Raises
    `PolicyError` if the policy states an observation other than the given one.
    """
    own = getattr(policy, "observation", None)
    if is_privileged(policy) or own == NO_OBSERVATION:
        return STATE
    if observation is not None and own not in (None, observation):
        raise PolicyError(f"observation {observation!s}: the policy states its own, {own!s}")
    chosen: Observation = own if observation is None else observation
    return DEFAULT_OBSERVATION if chosen is None else chosen


def observed(policy: Policy, observation: Observation, task: Task) -> tuple[str, bool]:
    """What a policy is shown in a task, as entries name it, and whether that is the true state.

    An observation without a name is named by its fields, as JSON.
    """
    if getattr(policy, "observation", None) == NO_OBSERVATION and not is_privileged(policy):
        return NO_OBSERVATION, False
    shown = observation_for(policy, observation)
    spec = make_spec(shown, task)
    name = shown if isinstance(shown, str) else spec.to_dict()
    return name if isinstance(name, str) else json.dumps(name), spec.num_images == 0


def given_to(policy: Policy, envs: MagicalVectorEnv, observations: Any) -> Any:
    """What `act` gets from environments that have returned these observations."""
    if is_privileged(policy):
        return envs.states()
    return None if getattr(policy, "observation", None) == NO_OBSERVATION else observations


class FunctionPolicy:
    """A policy without memory from a function `(observations, env_ids, rng) -> actions`.

    Its other attributes (see `Policy`) are those of the function, or of the object whose `act` it
    is.
    """

    def __init__(self, function: Callable[..., Any], owner: object = None) -> None:
        self.function, self._owner = function, function if owner is None else owner

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # for instance while it is being unpickled
            raise AttributeError(name)
        return getattr(self._owner, name)

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """Call the function."""
        actions: Actions = self.function(observations, env_ids, rng)
        return actions

    def reset(self, mask: Mask) -> None:
        """Nothing to reset."""


class RandomPolicy:
    """Every action with equal probability at every step."""

    observation = NO_OBSERVATION
    exact = True
    record: Mapping[str, Any] = {"learned_from": []}

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One uniform sample for each environment."""
        return rng.integers(NUM_ACTIONS, size=len(env_ids))

    def reset(self, mask: Mask) -> None:
        """Nothing to reset."""


class NoopPolicy(RandomPolicy):
    """The no-op at every step: its score is that of the initial scene."""

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """The no-op for each environment."""
        return np.full(len(env_ids), NOOP)
