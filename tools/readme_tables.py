"""Write the README's generated tables, between their `<!-- name -->` and `<!-- end -->` marks.

python tools/readme_tables.py [--check]

With --check nothing is written; the exit status is 1 if the README is out of date.
"""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from magical.cli import find_commands
from magical.observe import PRESETS, PixelSpec
from magical.tasks import TASKS, VARIANTS

README = Path(__file__).resolve().parents[1] / "README.md"


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def tasks() -> str:
    """How many there are; then a row for each task: goal, horizon, variants."""
    short = [name.removeprefix("Test") for name in VARIANTS]
    rows = (
        (
            f"`{task.name}`",
            task.summary,
            task.horizon,
            *("✓" if name in task.variants else "" for name in VARIANTS),
        )
        for task in TASKS.values()
    )
    environments = sum(len(task.variants) for task in TASKS.values())
    count = f"{len(TASKS)} tasks, {environments} environments:\n\n"
    return count + table(("Task", "What to do", "Horizon", *short), rows)


def presets() -> str:
    """One row an observation preset."""
    return table(
        ("Preset", "Observation"), ((f"`{name}`", describe(p)) for name, p in PRESETS.items())
    )


def describe(preset: PixelSpec) -> str:
    """A preset in words."""
    if preset.separate:
        entries = (f"`{view}` {preset.shape(frames)}" for view, frames in preset.parts)
        return f"dict of {', '.join(entries)}"
    views = " and ".join(f"{frames} `{view}`" for view, frames in preset.parts)
    return f"{views} frames, {preset.shape(sum(frames for _, frames in preset.parts))}"


def commands() -> str:
    """One row a command of the command line."""
    return table(
        ("Command", ""), ((f"`magical {name}`", module.HELP) for name, module in find_commands())
    )


TABLES = {"tasks": tasks, "presets": presets, "commands": commands}


def renew(text: str, page: Path, tables: Mapping[str, Callable[[], str]]) -> str:
    """A page's text with every table made anew."""
    for name, make in tables.items():
        before, found, rest = text.partition(f"<!-- {name} -->\n")
        _, closed, after = rest.partition("<!-- end -->")
        if not found or not closed:
            raise SystemExit(f"{page.name}: expected <!-- {name} --> and <!-- end -->")
        text = before + found + make() + "\n" + closed + after
    return text


def main(
    arguments: Sequence[str], page: Path = README, tables: Mapping[str, Callable[[], str]] = TABLES
) -> int:
    """Write a page's tables, or check them."""
    old = page.read_text(encoding="utf-8")
    new = renew(old, page, tables)
    if "--check" in arguments:
        return int(new != old)
    page.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
