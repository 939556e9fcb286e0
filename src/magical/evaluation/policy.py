"""The protocol of policies, simple policies, and loading one by name or from a user's object."""

import inspect
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.envs.action_spec import Actions as Actions
from magical.envs.action_spec import ActionSpec, action_spec
from magical.errors import MissingDependencyError, PolicyError, UnknownNameError
from magical.observe import STATE, Observation, make_spec
from magical.plugins import load_plugin, load_reference, plugins
from magical.scene import NOOP, NUM_ACTIONS, State
from magical.tasks import Task

Mask = NDArray[np.bool_]  # (B,)

DEFAULT_OBSERVATION = "LoRes4E"
NO_OBSERVATION = "nothing"  # the observation of a policy that needs none

# The group of other distributions' entry points: a policy, or for names `NAME:TEXT` a function of
# the text. The one named `run` loads run folders.
GROUP = "magical.policies"
RUN = "run"
# What brings the functions, and where it is in a clone of the repository.
BROUGHT_BY = {
    RUN: ("magical-baselines", "baselines"),
    "lerobot": ("lerobot_env_magical", "integrations/lerobot_env_magical"),
}


@runtime_checkable
class Policy(Protocol):
    """Chooses actions for a batch of B environments.

    It may also have the attributes `privileged`, `observation`, `action_space`, `tasks`,
    `in_processes`, `modules`, `updates`, `record`, `using_threads` and `exact`, which
    docs/own-policy.md describes. Missing ones count as `False` or `None`.
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


class FunctionPolicy:
    """A policy without memory from a function `(observations, env_ids, rng) -> actions`.

    Its other attributes (see `Policy`) are those of the function, or of the object whose `act` it
    is.
    """

    def __init__(self, function: Callable[..., Any], owner: object = None) -> None:
        self.act, self._owner = function, function if owner is None else owner

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # for instance while it is being unpickled
            raise AttributeError(name)
        return getattr(self._owner, name)

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


class ExpertPolicy:
    """Each environment's scripted expert, with a strategy sampled for every episode.

    The first `act` raises `NoExpertError` if a task has none. Experts are imported when used.
    """

    privileged = True
    exact = True
    in_processes = True  # it is fast to start and costly to run
    record: Mapping[str, Any] = {"learned_from": []}

    def __init__(self) -> None:
        self._experts: dict[int, Any] = {}  # an `EpisodeExpert` by row of the batch

    def act(
        self, observations: Sequence[State], env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> Actions:
        """Each expert's action in the current state."""
        if new := set(range(len(env_ids))) - self._experts.keys():
            from magical.experts import EpisodeExpert, expert_for

            seeds = rng.integers(2**31, size=len(env_ids)).tolist()
            for row in new:
                self._experts[row] = EpisodeExpert(expert_for(env_ids[row].task, seed=seeds[row]))
        return np.array([self._experts[row].act(state) for row, state in enumerate(observations)])

    def reset(self, mask: Mask) -> None:
        """Drop the experts of the environments that begin an episode."""
        for row in np.flatnonzero(mask).tolist():
            self._experts.pop(row, None)

    def __reduce__(self) -> tuple[type["ExpertPolicy"], tuple[()]]:
        """A copy for another process has no episode in progress."""
        return ExpertPolicy, ()

    def modules(self, tasks: Sequence[str]) -> list[str]:
        """The modules that a new process must import to have the tasks' experts."""
        from magical.experts import modules_of

        return sorted({module for task in tasks for module in modules_of(task)})


BUILT_IN: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "noop": NoopPolicy,
    "expert": ExpertPolicy,
}


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


def load_policy(source: object) -> Policy:
    """Load a policy from whatever describes one.

    - a name in `BUILT_IN`, or of another distribution's entry point;
    - `lerobot:PATH`, or another entry point's name and what it loads;
    - a run folder, whose newest checkpoint is loaded by the entry point `run`;
    - `module:name` or `path/to/file.py:name`. The working directory is searched last for the
      module, and only if it is found nowhere else;
    - a policy, or what such a name may refer to: an object with `act`, and `reset` if it has
      memory; a class or function that returns one when called without arguments; or a plain
      function `(observations, env_ids, rng) -> actions`.

    Raises:
        UnknownNameError: a text in none of these forms.
        PluginError, PolicyError: what it names cannot be imported, or is not a policy.
        RunFolderError, CheckpointError: the folder holds no run, or a damaged one.
        MissingDependencyError: what loads it is not installed.
    """
    if not isinstance(source, str | os.PathLike):
        return _as_policy(source)
    name = os.fspath(source)
    if name in BUILT_IN:
        return BUILT_IN[name]()
    if name in policy_names():
        return _as_policy(load_plugin(GROUP, name), name)
    if Path(name).is_dir():
        name = f"{RUN}:{name}"
    prefix, colon, text = name.partition(":")
    if colon and prefix in plugins(GROUP):
        return _as_policy(load_plugin(GROUP, prefix)(text), name)
    if colon and prefix in BROUGHT_BY:
        distribution, folder = BROUGHT_BY[prefix]
        raise MissingDependencyError(
            f"policy {name!r}: this needs {distribution}, which is not installed; in a clone of "
            f"the repository: pip install ./{folder}"
        )
    if not all(name.rpartition(":")):
        raise UnknownNameError(
            f"policy {name!r}: expected one of {', '.join(policy_names())}, a run "
            "folder, module:name or file.py:name"
        )
    return _as_policy(load_reference(name), name)


def policy_names() -> tuple[str, ...]:
    """The names in `BUILT_IN` and of other distributions' entry points; none is imported.

    They take precedence over folders with these names. Entries may have them loaded, since they
    are installed.
    """
    return (*BUILT_IN, *(name for name in plugins(GROUP) if name not in BROUGHT_BY))


def _as_policy(thing: Any, name: str = "policy") -> Policy:
    """Return or make a policy from what `load_policy` accepts; raises `PolicyError`."""
    made = thing
    acts = hasattr(thing, "act") or _takes(thing, "observations", "env_ids", "rng")
    if inspect.isclass(thing) or not acts:
        made = thing() if _takes(thing) else None
    act: Any = getattr(made, "act", thing if made is thing else None)
    if not _takes(act, "observations", "env_ids", "rng"):
        raise PolicyError(
            f"{name}: expected an object with act(observations, env_ids, rng), a class or function "
            "that returns one when called without arguments, or a function (observations, "
            f"env_ids, rng) -> actions, found {thing!r}"
        )
    return made if isinstance(made, Policy) else FunctionPolicy(act, made)


def _takes(function: Any, *arguments: str) -> bool:
    """Whether something can be called with these arguments."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # compiled functions need not have a signature
        return bool(arguments)
    return True
