"""Generates the reference: API, commands, configurations, errors, examples, the notebook."""

import argparse
import base64
import inspect
import os
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

from magical import cli, errors
from magical_baselines import Config, algorithm_names, find_algorithm
from magical_baselines.config import options
from tools import preset_tables, readme_tables
from tools.run_notebook import read_notebook

# Modules and a class that have a page. A module's page has its public names: `__all__`, or without
# it all names that do not begin with an underscore.
MODULES = {
    "magical": "Registered environments and tasks",
    "magical.envs": "Environment ids and registration",
    "magical.envs.env.MagicalEnv": "The environment",
    "magical.envs.vector": "Many environments at once",
    "magical.observe": "Observation specs",
    "magical.scene": "Scenes as plain data",
    "magical.tasks": "Tasks, variants, scores",
    "magical.render": "The renderer",
    "magical.experts": "Scripted experts",
    "magical.demos": "Datasets of demonstrations",
    "magical.demos.generate": "Demonstrations by experts",
    "magical.evaluation": "Evaluating policies",
    "magical.evaluation.statistics": "Statistics over runs",
    "magical.evaluation.entry": "Entries, and many of them in two files",
    "magical_baselines": "Training",
    "magical_baselines.config": "Configurations",
    "magical.runs": "Run folders",
    "magical_baselines.experiments.status": "Plans in progress",
}
COLAB = "https://colab.research.google.com/github"
WIDTH = "80"  # columns of a command's help


def pages(root: Path) -> dict[str, str | bytes]:
    """Every page, by its path in the site."""
    return {
        "api/index.md": api_index(),
        **{f"api/{name}.md": api_page(name) for name in MODULES},
        "errors.md": error_page(),
        **command_pages(),
        **configuration_pages(),
        **example_pages(root),
        **notebook_pages(root / "examples/tutorial.ipynb"),
    }


def api_index() -> str:
    """The index of the modules that have a page."""
    rows = ((f"[`{name}`]({name}.md)", what) for name, what in MODULES.items())
    return (
        "# API\n\nFrom the docstrings. Names that are neither here nor in the other pages are not "
        "public and may change.\n\n"
        f"{readme_tables.table(('Module', ''), rows)}\n"
    )


def api_page(name: str) -> str:
    """A module's page, which mkdocstrings fills."""
    return f"# {name}\n\n{MODULES[name]}.\n\n::: {name}\n"


def error_page() -> str:
    """Every error class, its other base classes and its meaning."""
    kinds = [
        kind
        for _, kind in inspect.getmembers(errors, inspect.isclass)
        if issubclass(kind, errors.MagicalError)
    ]
    rows = (
        (
            f"`{kind.__name__}`",
            " ".join(f"`{base.__name__}`" for base in kind.__bases__[1:]),
            " ".join((inspect.getdoc(kind) or "").split()),
        )
        for kind in sorted(kinds, key=lambda kind: kind.__name__)
    )
    return (
        "# Errors\n\nEvery error that the package raises on purpose is a class of "
        "`magical.errors`, below `MagicalError`. Its message says what was expected, what was "
        "found and what to do. On the command line it is printed to standard error, and the exit "
        "status is 1 (2 for an unknown name or a wrong plan).\n\n"
        f"{readme_tables.table(('Class', 'Also a', 'When'), rows)}\n"
    )


def command_pages() -> dict[str, str]:
    """A page for each command, with its help and that of its subcommands."""
    rows = (
        (f"[`magical {name}`]({name}.md)", help_) for name, help_ in cli.find_commands().items()
    )
    made = {
        "commands/index.md": (
            "# Commands\n\nEvery command takes `--help`; most take `--json`, with which the last "
            "line of standard output is one JSON object. The exit status is 0 for success, 1 when "
            "a check failed or an error occurred, 2 for wrong usage, 130 after an interrupt.\n\n"
            f"{readme_tables.table(('Command', ''), rows)}\n"
        )
    }
    with mock.patch.dict(os.environ, COLUMNS=WIDTH, NO_COLOR="1"):
        for name, parser in _subparsers(cli.build_parser()):
            text = "\n\n".join(_helps(f"magical {name}", parser, level=2))
            made[f"commands/{name}.md"] = f"# magical {name}\n\n{text}\n"
    return made


def _subparsers(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()


def _helps(name: str, parser: argparse.ArgumentParser, level: int) -> Iterator[str]:
    yield f"```text\n{parser.format_help().rstrip()}\n```"
    for inner, sub in _subparsers(parser):
        yield f"{'#' * level} {name} {inner}"
        yield from _helps(f"{name} {inner}", sub, level + 1)


def configuration_pages() -> dict[str, str]:
    """A page for each algorithm: settings by preset, with the appendix's values and meanings."""
    kinds = [find_algorithm(name).config for name in algorithm_names()]
    rows = ((f"[`{kind.algorithm}`]({kind.algorithm}.md)", _summary(kind)) for kind in kinds)
    made = {
        "configuration/index.md": (
            "# Configuration\n\nEvery setting is an option of `magical train ALGORITHM`, a keyword "
            "of `preset` and `replace` in Python, and, except `tasks`, `seed` and `demos`, a key "
            "of `settings` in plans. In the tables, what differs from the preset `paper` is bold; "
            "the last column has what the appendix states ([what the presets are for]"
            "(../baselines.md#presets)).\n\n"
            f"{readme_tables.table(('Algorithm', ''), rows)}\n"
        )
    }
    for kind in kinds:
        meaning = readme_tables.table(
            ("Setting", "Meaning"),
            ((f"`{preset_tables.flag(o)}`", o.metadata["help"]) for o in options(kind)),
        )
        made[f"configuration/{kind.algorithm}.md"] = (
            f"# {kind.algorithm}\n\n{_summary(kind)}\n\n## Values\n\n"
            f"{preset_tables.settings(kind)}\n\n## Meaning\n\n{meaning}\n"
        )
    return made


def _summary(kind: type[Config]) -> str:
    """The first paragraph of the docstring of an algorithm's module."""
    return (inspect.getdoc(inspect.getmodule(kind)) or "").split("\n\n")[0].replace("\n", " ")


def example_pages(root: Path) -> dict[str, str]:
    """A page for each program in `examples`."""
    made = {}
    for path in sorted((root / "examples").rglob("[!_]*.py")):
        source = path.read_text(encoding="utf-8")
        name = path.relative_to(root).with_suffix(".md").as_posix()
        made[name] = f"# {path.name}\n\n```python\n{source}```\n"
    return made


def notebook_pages(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page with its stored outputs; pictures are separate files."""
    notebook = read_notebook(path)
    place = f"examples/{path.stem}"
    repository = os.environ.get("GITHUB_REPOSITORY")  # set when a GitHub workflow builds the site
    colab = f"{COLAB}/{repository}/blob/main/{place}.ipynb"
    text = [f"[Open in Colab]({colab})"] if repository else []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        text.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            data = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in data:
                name = f"{path.stem}-{len(pictures)}.png"
                pictures[f"examples/{name}"] = base64.b64decode(data["image/png"])
                text.append(f"![output of the cell above]({name})")
            else:
                text.append(f"```text\n{''.join(data['text/plain']).rstrip()}\n```")
    return {f"{place}.md": "\n\n".join(text) + "\n", **pictures}
