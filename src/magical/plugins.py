"""Tasks, observations, experts, policies, algorithms, networks, commands: built-in or plug-ins.

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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from magical.errors import PluginError, UnknownNameError
from magical.grouping import group_by
from magical.messages import printable, quoted

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")

# What `import_user_module` has imported.
_imported_names: set[str] = set()
_imported_files: dict[Path, tuple[int, ModuleType]] = {}  # mtime_ns, module


@dataclass(frozen=True, slots=True)
class Registry(Generic[T]):
    """Named objects of one kind: entry points, and `module:NAME`.

    Attributes:
        noun: what they are, for messages, such as `algorithm`.
        kind: their type; a protocol must be `runtime_checkable`.
        group: the group of the entry points, such as `magical.algorithms`.
    """

    noun: str
    kind: type[T]
    group: str

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
def plugins(group: str) -> "Mapping[str, list[EntryPoint]]":
    """What other distributions offer in a group of entry points, by name; none is imported."""
    return group_by((e for e in _entries(group) if not _is_pattern(e.name)), attrgetter("name"))


@cache
def families(group: str) -> "Mapping[str, list[EntryPoint]]":
    """As `plugins`, for families, by pattern."""
    return group_by((e for e in _entries(group) if _is_pattern(e.name)), attrgetter("name"))


def _entries(group: str) -> "Iterable[EntryPoint]":
    if not _any_offered():
        return ()
    from importlib.metadata import entry_points  # takes tens of milliseconds and is seldom needed

    return entry_points(group=group)


def _is_pattern(name: str) -> bool:
    return any(character in "*?[" for character in name)


def family_of(group: str, name: str) -> str | None:
    """The pattern of the family that has a name, if there is one."""
    return next((pattern for pattern in families(group) if fnmatchcase(name, pattern)), None)


@cache
def distributions() -> Mapping[str, str]:
    """Names and versions of the installed distributions with entry points for this package."""
    if not _any_offered():
        return {}
    from importlib import metadata

    offer = [
        found
        for found in metadata.distributions()
        if any(entry.group.startswith("magical.") for entry in found.entry_points)
    ]
    return {found.name: found.version for found in offer}


def _any_offered() -> bool:
    """Whether an installed distribution has entry points for this package (not one in a zip)."""
    files = (file for path in sys.path for file in Path(path).glob("*-info/entry_points.txt"))
    return any(b"[magical." in file.read_bytes() for file in files)


def is_offered(group: str, name: str) -> bool:
    """Whether a name is that of an entry point, or in a family."""
    return name in plugins(group) or family_of(group, name) is not None


def is_plugin(group: str, name: str) -> bool:
    """As `is_offered`, or of the form `module:NAME`."""
    return ":" in name or is_offered(group, name)


def load_plugin(group: str, name: str) -> Any:
    """Import what an entry point or `module:NAME` refers to, or the object that a family has.

    Raises:
        PluginError: it cannot be imported, or two distributions offer different objects under this
            name.
    """
    if ":" in name:
        return load_reference(name)
    if name not in plugins(group) and (pattern := family_of(group, name)) is not None:
        return load_family(group, pattern)(name)
    return _loaded(group, name, plugins(group)[name])


def load_family(group: str, pattern: str) -> Any:
    """Import the function of a family; raises `PluginError` as `load_plugin` does."""
    return _loaded(group, pattern, families(group)[pattern])


def _loaded(group: str, name: str, entries: "Sequence[EntryPoint]") -> Any:
    entry, *others = entries
    values = sorted({each.value for each in (entry, *others)})
    if len(values) > 1:
        raise PluginError(
            f"{group}: two distributions offer {name!r}: {' and '.join(values)}; uninstall one"
        )
    try:
        return entry.load()
    except Exception as error:  # its module may raise anything
        source = f" of {entry.dist.name}" if entry.dist else ""
        raise PluginError(
            f"{group}: {name!r}{source} cannot be imported from {entry.value}: "
            f"{type(error).__name__}: {error}"
        ) from error


def load_reference(reference: str) -> Any:
    """What `module:NAME` or `path/to/file.py:NAME` refers to.

    Raises:
        PluginError: the module cannot be imported, or has no such name.
    """
    module_name, _, attribute = reference.rpartition(":")
    module = import_user_module(module_name)
    if not attribute or not hasattr(module, attribute):
        known = ", ".join(word for word in vars(module) if not word.startswith("_"))
        raise PluginError(f"{reference!r}: no {attribute!r} in the module, which has: {known}")
    return getattr(module, attribute)


def import_user_module(name: str) -> ModuleType:
    """Import a user's module by its name or by the path of its file.

    The working directory, or a file's own folder, is searched last, and for a module only if it is
    found nowhere else, so that nothing there shadows a library. From then on files such as
    `config.json` may name objects of the module.

    Raises:
        PluginError: it cannot be imported.
    """
    if name.endswith(".py"):
        return _import_file(Path(name))
    package, *others = name.split(".")
    try:
        if not all(map(str.isidentifier, (package, *others))):
            raise ModuleNotFoundError(f"{name!r} is not a module's name")
        if package not in sys.modules and importlib.util.find_spec(package) is None:
            _search_last(Path.cwd())
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise PluginError(
            f"module {name!r} cannot be imported: {error}; give a module on the import path or in "
            "the working directory, or a path ending in .py"
        ) from error
    _imported_names.add(name)
    return module


def _import_file(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise PluginError(f"file {path}: expected a Python file, found none")
    written = path.stat().st_mtime_ns
    known = _imported_files.get(path.resolve())
    if known and known[0] == written:  # what it registers is registered already
        return known[1]
    _search_last(path.resolve().parent)
    module = importlib.util.module_from_spec(spec)
    if known:  # so that pickle finds the present contents of the file by its name
        _forget(path.stem, known[1])
    sys.modules.setdefault(path.stem, module)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        _forget(path.stem, module)
        raise
    _imported_files[path.resolve()] = written, module
    return module


def _forget(name: str, module: ModuleType) -> None:
    if sys.modules.get(name) is module:
        del sys.modules[name]


def _search_last(folder: Path) -> None:
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def require_imported(name: str, what: str) -> None:
    """Check that an object that a file names may be used.

    A file may name what is built in, and entry points. Anything else is code that may have come
    with the file: `module:NAME` only if the person who runs this program has imported that module,
    by `--import` or by naming something in it.

    Args:
        name: the name of a plug-in of any kind.
        what: what the message calls the file.

    Raises:
        PluginError: its module was not imported.
    """
    module, colon, _ = name.rpartition(":")
    if not colon or _was_imported(module):
        return
    raise PluginError(
        f"{what} names {quoted(name)}, and its module is not one that you imported; if you trust "
        f"it, add to the command: --import {shlex.quote(printable(module))} (in Python first call "
        f"magical.plugins.import_user_module({quoted(module)}))"
    )


def _was_imported(module: str) -> bool:
    """Whether `import_user_module` has imported a module, by its name or as a file."""
    if module.endswith(".py"):
        return "\0" not in module and Path(module).resolve() in _imported_files
    files = (found for _, found in _imported_files.values())
    return module in _imported_names or any(sys.modules.get(module) is found for found in files)
