"""Measures the effect of each constant of the scripted experts.

python benchmarks/expert_constants.py OUT.csv [--only NAME ...] [--tasks TASK ...] [--rollouts N]

The numbers in the definition of every public constant at the top level of a file in
`magical.experts` are multiplied by each factor, in a copy of the package, and the expert is rolled
out in a few TestAll episodes. (The constant of `noise` is left out: the expert does not use it.)
OUT.csv has a row for each constant and factor: the mean score, its difference from the score with
unchanged constants, and the fraction of episodes in which any action differs. Repeating the command
continues where it stopped; a constant whose definition has changed since is measured again.
"""

import argparse
import ast
import csv
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import magical
from magical.progress import ProgressBar
from magical.tasks import TASKS

FACTORS = (0.5, 1.5)
FIRST_SEED = 70_000  # these seeds are not used in evaluation (docs/protocol.md)
PACKAGE = Path(str(magical.__file__)).parent / "experts"
HEADER = ("file", "constant", "definition", "factor", "score", "difference", "changed")


class Constant(NamedTuple):
    """A constant and the location of its definition."""

    file: str  # relative to `magical.experts`
    name: str
    definition: str
    numbers: tuple[ast.Constant, ...]  # in the definition, ordered by position

    def scaled(self, factor: float) -> str:
        """The file's text with the constant's numbers multiplied."""
        lines = (PACKAGE / self.file).read_text().splitlines(keepends=True)
        for number in reversed(self.numbers):
            line = lines[number.lineno - 1]
            new = repr(_scale(number.value, factor))
            lines[number.lineno - 1] = (
                line[: number.col_offset] + new + line[number.end_col_offset :]
            )
        return "".join(lines)


def _scale(value: Any, factor: float) -> float:
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def find_constants() -> Iterator[Constant]:
    """Every public constant of the experts with a number in its definition, by file."""
    for path in sorted(set(PACKAGE.rglob("*.py")) - {PACKAGE / "noise.py"}):
        text = path.read_text()
        for node in ast.parse(text).body:
            if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
                continue
            name, inner = node.targets[0].id, list(ast.walk(node.value))
            # In computed definitions, integers are counts and are not scaled.
            computed = any(isinstance(part, ast.Name) for part in inner)
            kinds = float if computed else (int, float)
            numbers = [
                p for p in inner if isinstance(p, ast.Constant) and isinstance(p.value, kinds)
            ]
            if name.isupper() and not name.startswith("_") and numbers:
                definition = str(ast.get_source_segment(text, node.value))
                numbers.sort(key=lambda number: (number.lineno, number.col_offset))
                yield Constant(str(path.relative_to(PACKAGE)), name, definition, tuple(numbers))


def roll_out(
    tasks: Sequence[str], rollouts: int, constant: Constant | None = None, factor: float = 1.0
) -> list[Any] | None:
    """Score and actions of each episode, run in a subprocess; None if the expert fails."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "experts"
        shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
        if constant:
            (copy / constant.file).write_text(constant.scaled(factor))
        command = [sys.executable, __file__, "--child", folder, "--tasks", *tasks]
        command += ["--rollouts", str(rollouts)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    return list(json.loads(done.stdout)) if done.returncode == 0 else None


def child(folder: str, tasks: Sequence[str], rollouts: int) -> None:
    """Print what `roll_out` returns, using the experts in a folder instead of the package's."""
    magical.__path__.insert(0, folder)
    from magical.experts import rollout

    seeds = range(FIRST_SEED, FIRST_SEED + rollouts)
    episodes = [rollout(task, "TestAll", seed) for task in tasks for seed in seeds]
    print(json.dumps([(episode.score, episode.actions.tolist()) for episode in episodes]))


def measure(out: Path, tasks: Sequence[str], rollouts: int, only: Sequence[str]) -> None:
    """Append the missing rows to the table."""
    rows = list(csv.reader(out.open())) if out.exists() else [list(HEADER)]
    done = {tuple(row[:4]) for row in rows}
    wanted = [
        (constant, factor)
        for constant in find_constants()
        for factor in FACTORS
        if not only or constant.name in only
        if (constant.file, constant.name, constant.definition, str(factor)) not in done
    ]
    before = roll_out(tasks, rollouts) if wanted else []
    if before is None:
        raise SystemExit("the experts fail as they are")
    with out.open("a", newline="") as file, ProgressBar("constants", len(wanted)) as bar:
        writer = csv.writer(file)
        if not done - {HEADER[:4]}:
            writer.writerow(HEADER)
        for constant, factor in wanted:
            after = roll_out(tasks, rollouts, constant, factor)
            writer.writerow([*constant[:3], factor, *_compare(before, after)])
            file.flush()
            bar.advance(1)


def _compare(before: Sequence[Any], after: Sequence[Any] | None) -> tuple[str, ...]:
    if after is None:
        return "fails", "", ""
    mean, old = (sum(score for score, _ in rows) / len(rows) for rows in (after, before))
    changed = sum(a[1] != b[1] for a, b in zip(after, before, strict=True)) / len(before)
    return f"{mean:.4f}", f"{mean - old:+.4f}", f"{changed:.2f}"


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("out", nargs="?", type=Path, default=Path("expert_constants.csv"))
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="default: all")
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), metavar="TASK")
    parser.add_argument("--rollouts", type=int, default=3, metavar="N", help="of each task")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        child(args.child, args.tasks, args.rollouts)
    else:
        measure(args.out, args.tasks, args.rollouts, args.only)


if __name__ == "__main__":
    main()
