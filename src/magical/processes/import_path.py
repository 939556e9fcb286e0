"""What a child process can import: what its parent would, except from the working folder."""

import os
import sys
from collections.abc import Collection
from importlib.machinery import ModuleSpec
from pathlib import Path


def import_path() -> list[str]:
    """`sys.path` for a child: this process's, without the working folder unless it was chosen.

    Python adds the working folder by itself for `python -m`, `python -c`, a prompt and an empty
    entry of PYTHONPATH. A file there, perhaps in a run folder from elsewhere, would be imported in
    place of a library of the same name. The folder counts as chosen if it is the main script's, if
    PYTHONPATH names it, or if the program has added it to `sys.path`.
    """
    entries = [_absolute(entry) for entry in sys.path if isinstance(entry, str) and entry]
    variable = _python_path()
    added = _is_run_as_module() + ("" in variable)
    if not added:
        return entries
    here = str(Path.cwd())
    named = here in [_absolute(entry) for entry in variable if entry]
    chosen = named or entries.count(here) > added
    return [entry for entry in entries if chosen or entry != here]


def folders_of_modules(path: Collection[str]) -> dict[str, str]:
    """Where this process has found top-level modules that are in none of the folders of `path`.

    With these a child finds, say, a task's module beside a notebook, but no other file there.
    """
    folders = {}
    for name, module in list(sys.modules.items()):
        spec = getattr(module, "__spec__", None)
        if not isinstance(spec, ModuleSpec) or spec.name != name or "." in name:
            continue
        file = spec.origin if spec.has_location else None
        place = next(iter(spec.submodule_search_locations or ()), file)
        if place and (folder := str(Path(_absolute(place)).parent)) not in path:
            folders[name] = folder
    return folders


def absolute_python_path() -> str:
    """PYTHONPATH for a child, which imports with it until its `sys.path` is set.

    Relative entries (an empty one too) are left out: they mean folders below the working folder,
    which may have changed. `import_path` has those that were chosen.
    """
    return os.pathsep.join(entry for entry in _python_path() if Path(entry).is_absolute())


def _python_path() -> list[str]:
    """The entries of PYTHONPATH, if this interpreter has read it."""
    variable = os.environ.get("PYTHONPATH")
    return variable.split(os.pathsep) if variable and not sys.flags.ignore_environment else []


def _is_run_as_module() -> bool:
    """Whether `python -m` has put the working folder on `sys.path`."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    return spec is not None and spec.name != "__main__" and not sys.flags.safe_path


def _absolute(path: str) -> str:
    return str(Path(path).absolute())
