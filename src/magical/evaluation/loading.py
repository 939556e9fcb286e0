"""Loading policies: by name, from a run folder, or from a user's own object or `module:name`."""

import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from magical.errors import MissingDependencyError, PolicyError, UnknownNameError
from magical.evaluation.policy import FunctionPolicy, NoopPolicy, Policy, RandomPolicy
from magical.plugins import load_plugin, plugins


def _expert() -> Policy:
    from magical.evaluation.expert import ExpertPolicy  # imported only when it is used

    return ExpertPolicy()


BUILT_IN: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "noop": NoopPolicy,
    "expert": _expert,
}


GROUP = "magical.policies"  # the group of other distributions' entry points
# The group for functions that load the policies of another tool: `lerobot:PATH` is what the one
# named `lerobot` returns for PATH. The one named `run` loads run folders.
LOADERS = "magical.policy_loaders"
RUN = "run"
# By loader: its distribution, and the folder of the repository that holds it.
LOADING = {
    RUN: ("magical-baselines", "baselines"),
    "lerobot": ("lerobot_env_magical", "integrations/lerobot_env_magical"),
}


class Acting(Protocol):
    """An object with `act`: a `Policy`, or an object without memory, which needs no `reset`."""

    @property
    def act(self) -> Callable[..., Any]:
        """See `Policy.act`."""


PolicySource = str | os.PathLike[str] | Acting | Callable[..., Any]  # for `load_policy`


def load_policy(source: PolicySource) -> Policy:
    """Load a policy from whatever describes one.

    Args:
        source: one of

            - a name in `BUILT_IN`, or of another distribution's entry point;
            - `lerobot:PATH`, or another loader's name and what it loads;
            - a run folder, whose newest checkpoint is loaded by magical-baselines
              (`magical_baselines.load_policy` also chooses the device, or greedy actions);
            - `module:name` or `path/to/file.py:name`. The working directory is searched last for
              the module, and only if it is found nowhere else;
            - a policy, or what such a name may refer to: an object with `act`, and `reset` if it
              has memory; a class or function that returns one when called without arguments; or a
              plain function `(observations, env_ids, rng) -> actions`.

    Raises:
        UnknownNameError: a text in none of these forms.
        PluginError: the module or the name in it cannot be found.
        PolicyError: it is not a policy.
        RunFolderError, CheckpointError: the folder holds no run, or a damaged one.
        MissingDependencyError: PyTorch, for a run folder, or a loader's distribution is not
            installed.
    """
    if not isinstance(source, str | os.PathLike):
        return _as_policy(source)
    name = os.fspath(source)
    if name in BUILT_IN:
        return BUILT_IN[name]()
    if name not in policy_names() and Path(name).is_dir():
        name = f"{RUN}:{name}"
    loader, colon, what = name.partition(":")
    if colon and loader in plugins(LOADERS):
        return _as_policy(load_plugin(LOADERS, loader)(what), name)
    if colon and loader in LOADING:
        distribution, folder = LOADING[loader]
        raise MissingDependencyError(
            f"policy {name!r}: this needs {distribution}, which is not installed; in a clone of "
            f"the repository: pip install ./{folder}"
        )
    return _as_policy(_attribute(name), name)


def policy_names() -> tuple[str, ...]:
    """The names in `BUILT_IN` and of other distributions' entry points; none is imported.

    They take precedence over folders with these names. Entries may have them loaded, since they
    are installed.
    """
    return (*BUILT_IN, *plugins(GROUP))


def _as_policy(thing: Any, name: str = "policy") -> Policy:
    """Return or make a policy from what `load_policy` accepts; raises `PolicyError`."""
    if not inspect.isclass(thing) and callable(getattr(thing, "act", None)):
        _check_signature(thing.act, name)
        return thing if isinstance(thing, Policy) else FunctionPolicy(thing.act, thing)
    if not callable(thing):
        raise PolicyError(f"{name}: {_EXPECTED}, found {type(thing).__name__} {thing!r}")
    if not _needs_arguments(thing):
        made = thing()
        if not callable(getattr(made, "act", None)):
            raise PolicyError(f"{name}: called without arguments; {_EXPECTED}, found {made!r}")
        return _as_policy(made, name)
    if inspect.isclass(thing):
        raise PolicyError(
            f"{name}: expected a class that can be instantiated without arguments, found "
            f"{thing.__name__}; name a function that makes it"
        )
    _check_signature(thing, name)
    return FunctionPolicy(thing)


def _check_signature(act: Callable[..., Any], name: str) -> None:
    try:
        inspect.signature(act).bind("observations", "env_ids", "rng")
    except TypeError as error:
        raise PolicyError(f"{name}: {_EXPECTED}, found {act!r}: {error}") from error
    except ValueError:  # compiled functions need not have a signature
        pass


_EXPECTED = (
    "expected an object with act(observations, env_ids, rng), something that returns one when "
    "called without arguments, or a function (observations, env_ids, rng) -> actions"
)


def _needs_arguments(thing: Callable[..., Any]) -> bool:
    try:
        signature = inspect.signature(thing)
        signature.bind()
    except (TypeError, ValueError):  # it needs arguments, or has no signature
        return True
    takes_any = any(p.kind is p.VAR_POSITIONAL for p in signature.parameters.values())
    return takes_any and not inspect.isclass(thing)


def _attribute(name: str) -> Any:
    """What the name of an entry point, `module:name` or `file.py:name` refers to."""
    module_name, _, attribute = name.rpartition(":")
    if name in plugins(GROUP) or (module_name and attribute):
        return load_plugin(GROUP, name)
    raise UnknownNameError(
        f"policy {name!r}: expected one of {', '.join(policy_names())}, a run "
        "folder, module:name or file.py:name"
    )
