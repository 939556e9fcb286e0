"""Hold every room of the project to its budget in lines, and every file to 800.

python tools/budgets.py [--table]

The budgets stand in `pyproject.toml`, `[tool.budgets]`: the room's files as patterns (a pattern
that begins with an exclamation mark takes files out), the number of lines that is held, and the
goal where the room is still larger.
"""

import sys
import tomllib
from pathlib import Path

MAX_FILE_LINES = 800


def lines_of(path: Path) -> int:
    return len(path.read_bytes().splitlines())


def room(root: Path, patterns: list[str]) -> set[Path]:
    """The Python files that the patterns name; later patterns take out what begins with `!`."""
    files: set[Path] = set()
    for pattern in patterns:
        found = set(root.glob(pattern.removeprefix("!")))
        files = files - found if pattern.startswith("!") else files | found
    return {path for path in files if path.suffix == ".py" and path.is_file()}


def main(root: Path, table: bool) -> int:
    """Print what is over its budget, or all rooms; returns 1 if anything is over."""
    budgets = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["tool"]["budgets"]
    over = []
    everything: set[Path] = set()
    for name, budget in budgets.items():
        files = room(root, budget["files"])
        everything |= files
        lines = sum(map(lines_of, files))
        if table:
            goal = f", goal {budget['goal']:6,}" if "goal" in budget else ""
            print(f"{name:32} {lines:7,} of {budget['lines']:7,}{goal}")
        if lines > budget["lines"]:
            over.append(f"{name}: {lines:,} lines, the budget is {budget['lines']:,}")
    over += [
        f"{path.relative_to(root)}: {lines} lines, at most {MAX_FILE_LINES}"
        for path in sorted(everything)
        if (lines := lines_of(path)) > MAX_FILE_LINES
    ]
    print(*over, sep="\n", end="\n" if over else "", file=sys.stderr)
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main(Path(__file__).parents[1], "--table" in sys.argv[1:]))
