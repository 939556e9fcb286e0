"""Loading policies: by name, from a run folder, or from a user's own object or `module:name`."""

import inspect
import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Protocol

from magical.errors import MissingDependencyError, PolicyError, UnknownNameError
from magical.evaluation.entry import Entry
from magical.evaluation.policy import FunctionPolicy, NoopPolicy, Policy, RandomPolicy
from magical.messages import quoted
from magical.plugins import load_plugin, load_reference, plugins
from magical.runs import is_run


def _expert() -> Policy:
    from magical.evaluation.expert import ExpertPolicy  # imported only when it is used

    return ExpertPolicy()


BUILT_IN: dict[str, Callable[[], Policy]] = {
    "random": RandomPolicy,
    "noop": NoopPolicy,
    "expert": _expert,
}
# The group of other distributions' entry points: a policy, or for names `NAME:TEXT` a function of
# the text. The one named `run` loads run folders.
GROUP = "magical.policies"
RUN = "run"
# What brings the functions, and where it is in a clone of the repository.
BROUGHT_BY = {
    RUN: ("magical-baselines", "baselines"),
    "lerobot": ("lerobot_env_magical", "integrations/lerobot_env_magical"),
}


class Acting(Protocol):
    """An object with `act`: a `Policy`, or an object without memory, which needs no `reset`."""

    @property
    def act(self) -> Callable[..., Any]:
        """As that of `Policy`."""


PolicySource = str | os.PathLike[str] | Acting | Callable[..., Any]  # for `load_policy`


def load_policy(source: PolicySource) -> Policy:
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


def policy_of(folder: Path, entry: Entry, run: Path | None = None) -> Policy:
    """The policy of an evaluated run: from its run folder, or by a name in `policy_names`.

    Other code that an entry names is not run, since entries may come from anywhere. `run` is the
    run folder if the entry names none. Raises `PolicyError` if it has no such policy.
    """
    name = entry.record.policy
    if name in policy_names():
        return load_policy(name)
    for place in (folder / name, run or folder):
        if is_run(place):
            return load_policy(place)
    raise PolicyError(
        f"{folder}: expected a run folder or one of {', '.join(policy_names())} as the policy "
        f"that was evaluated, found {quoted(name)}; magical verify takes others by --policy"
    )


def recorded_threads(policy: Policy, entry: Entry) -> AbstractContextManager[None]:
    """A context in which a policy uses as many CPU threads as in an entry's evaluation.

    Another number may change the last bit of a network's arithmetic.
    """
    using: Callable[[int], AbstractContextManager[None]] | None
    using = getattr(policy, "using_threads", None)
    return using(entry.record.threads) if using and entry.record.threads else nullcontext()


_EXPECTED = (
    "expected an object with act(observations, env_ids, rng), something that returns one when "
    "called without arguments, or a function (observations, env_ids, rng) -> actions"
)


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


def _needs_arguments(thing: Callable[..., Any]) -> bool:
    try:
        signature = inspect.signature(thing)
        signature.bind()
    except (TypeError, ValueError):  # it needs arguments, or has no signature
        return True
    takes_any = any(p.kind is p.VAR_POSITIONAL for p in signature.parameters.values())
    return takes_any and not inspect.isclass(thing)
