"""Which generated tasks the scripted expert solves, and the suite that follows from it.

    python -m studies.generated_tasks.check 0 300

Adds a line for each number to `expert.csv` beside this file, where it lacks one; the same command
continues one that was interrupted. Then it prints the numbers of the suite, as they stand in
`magical_goals.language.generated`, and what was rejected.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from magical.evaluation import environments, evaluate, load_policy, summarise
from magical.evaluation.protocol import NUDGE
from magical_goals.language.generated import task_name
from magical_goals.language.programs import PROGRAMS, program_of

SCORES = Path(__file__).with_name("expert.csv")
FIELDS = ("number", "program", "Demo", "All")
SIZE = 96  # of the suite
LEAST_SCORES = {"Demo": 0.9, "All": 0.8}  # minimum mean scores of the expert, by variant
ROLLOUTS = 20  # of each environment, with the seeds of an evaluation


def read_scores() -> dict[int, dict[str, str]]:
    """The lines of `expert.csv` by number."""
    if not SCORES.exists():
        return {}
    with SCORES.open(newline="", encoding="utf-8") as file:
        return {int(row["number"]): row for row in csv.DictReader(file)}


def new_programs(first: int, last: int) -> Iterator[tuple[int, str]]:
    """Numbers from `first`, below `last`, with programs that no lower number and no task has."""
    seen = set(map(repr, PROGRAMS.values()))
    for number in range(last):
        program = repr(program_of(task_name(number)))
        if program not in seen and number >= first:
            yield number, program
        seen.add(program)


def score(number: int) -> dict[str, str]:
    """The expert's mean scores on Demo and TestAll."""
    env_ids = environments([task_name(number)], LEAST_SCORES)
    scores = evaluate(load_policy("expert"), env_ids, rollouts=ROLLOUTS, workers=0, nudge=NUDGE)
    return {variant: f"{row['mean']:.4f}" for variant, row in summarise(scores).items()}


def is_solved(row: dict[str, str]) -> bool:
    """Whether the expert's scores suffice for the suite."""
    return all(float(row[variant]) >= least for variant, least in LEAST_SCORES.items())


def main() -> None:
    """Score what is missing, then print the suite."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    args = parser.parse_args()
    rows = read_scores()
    for number, program in new_programs(args.first, args.last):
        if number not in rows:
            rows[number] = {"number": str(number), "program": program, **score(number)}
            with SCORES.open("a", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, FIELDS)
                if not file.tell():
                    writer.writeheader()
                writer.writerow(rows[number])
    checked = [number for number, _ in new_programs(0, max(rows) + 1)]
    solved = [number for number in checked if number in rows and is_solved(rows[number])]
    print("suite:", solved[:SIZE])
    last = solved[SIZE - 1] if len(solved) >= SIZE else max(rows)
    print(f"numbers 0 to {last}: {last + 1 - sum(n <= last for n in checked)} repeat a program")
    failed = Counter(n in solved for n in checked if n <= last)
    print(f"{failed[False]} of {failed.total()} rejected, where the expert fails")


if __name__ == "__main__":
    main()
