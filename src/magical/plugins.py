"""Tasks, observations, experts, policies, algorithms, networks, commands of other distributions.

A distribution offers one through an entry point, for instance

    [project.entry-points."magical.algorithms"]
    my-bc = "my_package.bc:ALGORITHM"

and anything that can be imported can be named as `module:NAME` or `file.py:NAME`, on the command
line and in calls. Names that are read from files go through `require_imported` first.

An entry whose name is a pattern, such as `"Generated[0-9]*"`, is a family: a function from a name
that the pattern matches to an object.
"""

import importlib
import importlib.util
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from magical.errors import PluginError, UnknownNameError
from magical.grouping import group_by
from magical.messages import printable, quoted

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

T = TypeVar("T")

# What `import_user_module` has imported: by its name, and a file's by its path, too.
_imported: dict[str, ModuleType] = {}


@dataclass(frozen=True, slots=True)
class Registry(Generic[T]):
    """Named objects of one kind: entry points, and `module:NAME`."""

    noun: str  # what they are, for messages, such as `algorithm`
    kind: type[T]  # a protocol must be `runtime_checkable`
    group: str  # of the entry points, such as `magical.algorithms`

    def names(self) -> list[str]:
        """The names of the entry points, alphabetically; nothing is imported."""
        return sorted(plugins(self.group))

    def get(self, name: str) -> T:
        """The object with a name, or the one that `module:NAME` refers to.

        Raises:
            UnknownNameError: there is none with this name; the message lists the names.
            PluginError: it cannot be imported, or has the wrong type.
        """
        if not is_plugin(self.group, name):
            raise UnknownNameError(
                f"{self.noun} {name!r} is unknown; expected one of: {', '.join(self.names())}; or "
                "module:NAME"
            )
        thing = load_plugin(self.group, name)
        if not isinstance(thing, self.kind):
            raise PluginError(
                f"{self.noun} {name!r}: expected {self.kind.__name__}, found {type(thing).__name__}"
            )
        return thing


@cache
def _distributions() -> "list[Distribution]":
    """The installed distributions with entry points for this package (not those in a zip).

    `importlib.metadata` would read those of every distribution, which takes tens of milliseconds.
    """
    files = (file for path in sys.path for file in Path(path).glob("*-info/entry_points.txt"))
    folders = [file.parent for file in files if b"[magical." in file.read_bytes()]
    if not folders:
        return []
    from importlib.metadata import PathDistribution  # takes ten milliseconds

    return [PathDistribution(folder) for folder in dict.fromkeys(folders)]


def distributions() -> Mapping[str, str]:
    """Names and versions of the installed distributions with entry points for this package."""
    return {found.name: found.version for found in _distributions()}


@cache
def _entries(group: str) -> "Mapping[str, list[EntryPoint]]":
    entries = (entry for found in _distributions() for entry in found.entry_points)
    return group_by((e for e in entries if e.group == group), lambda entry: entry.name)


def plugins(group: str) -> list[str]:
    """The names of what other distributions offer in a group; none is imported."""
    patterns = families(group)
    return [name for name in _entries(group) if name not in patterns]


def families(group: str) -> list[str]:
    """As `plugins`, the patterns of families."""
    return [name for name in _entries(group) if set(name) & set("*?[")]


def family_of(group: str, name: str) -> str | None:
    """The pattern of the family that has a name, if there is one."""
    return next((pattern for pattern in families(group) if fnmatchcase(name, pattern)), None)


def is_offered(group: str, name: str) -> bool:
    """Whether a name is that of an entry point, or in a family."""
    return name in plugins(group) or family_of(group, name) is not None


def is_plugin(group: str, name: str) -> bool:
    """As `is_offered`, or of the form `module:NAME`."""
    return ":" in name or is_offered(group, name)


def load_plugin(group: str, name: str) -> Any:
    """Import what an entry point or `module:NAME` refers to, or the object that a family has.

    For a family's pattern this is the family. Raises `PluginError` if it cannot be imported, or two
    distributions offer different objects under this name.
    """
    if ":" in name:
        return load_reference(name)
    if name not in _entries(group) and (pattern := family_of(group, name)) is not None:
        return load_plugin(group, pattern)(name)
    entries = _entries(group)[name]
    if len(values := sorted({entry.value for entry in entries})) > 1:
        raise PluginError(
            f"{group}: two distributions offer {name!r}: {' and '.join(values)}; uninstall one"
        )
    try:
        return entries[0].load()
    except Exception as error:  # its module may raise anything
        source = f" of {entries[0].dist.name}" if entries[0].dist else ""
        raise PluginError(
            f"{group}: {name!r}{source} cannot be imported from {values[0]}: "
            f"{type(error).__name__}: {error}"
        ) from error


def load_reference(reference: str) -> Any:
    """What `module:NAME` or `path/to/file.py:NAME` refers to.

    Raises `PluginError` if the module cannot be imported, or has no such name.
    """
    module_name, _, attribute = reference.rpartition(":")
    module = import_user_module(module_name)
    if not attribute or not hasattr(module, attribute):
        known = ", ".join(word for word in vars(module) if not word.startswith("_"))
        raise PluginError(f"{reference!r}: no {attribute!r} in the module, which has: {known}")
    return getattr(module, attribute)


def import_user_module(name: str) -> ModuleType:
    """Import a user's module by its name or by the path of its file; raises `PluginError`.

    The working directory, or a file's own folder, is searched last, so that nothing there shadows a
    library. From then on files such as `config.json` may name objects of the module.
    """
    if name.endswith(".py"):
        return _import_file(Path(name).resolve())
    _search_last(Path.cwd())
    try:
        if not all(map(str.isidentifier, name.split("."))):
            raise ModuleNotFoundError(f"{name!r} is not a module's name")
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise PluginError(
            f"module {name!r} cannot be imported: {error}; give a module on the import path or in "
            "the working directory, or a path ending in .py"
        ) from error
    _imported[name] = module
    return module


def _import_file(path: Path) -> ModuleType:
    if module := _imported.get(str(path)):  # what it registers is registered already
        return module
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise PluginError(f"file {path}: expected a Python file, found none")
    _search_last(path.parent)
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(path.stem, module)  # pickle finds its objects by this name
    spec.loader.exec_module(module)
    _imported[str(path)] = module
    if sys.modules[path.stem] is module:
        _imported[path.stem] = module
    return module


def _search_last(folder: Path) -> None:
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def require_imported(name: str, what: str) -> None:
    """Raise `PluginError` unless a file, in messages `what`, may name this object.

    A file may name what is built in, and entry points. Anything else is code that may have come
    with the file: `module:NAME` only if the person who runs this program has imported that module,
    by `--import` or by naming something in it.
    """
    module, colon, _ = name.rpartition(":")
    paths = () if "\0" in module else (str(Path(module).resolve()),)
    if not colon or any(known in _imported for known in (module, *paths)):
        return
    raise PluginError(
        f"{what} names {quoted(name)}, and its module is not one that you imported; if you trust "
        f"it, add to the command: --import {shlex.quote(printable(module))} (in Python first call "
        f"magical.plugins.import_user_module({quoted(module)}))"
    )
