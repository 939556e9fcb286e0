"""How many programs explain demonstrations of a scene, and how uncertain they leave a reader.

    python -m studies.generated_tasks.ambiguity --generated 16

Every program with selections of at most two parts, by itself or two of them together, is held
against the expert's demonstrations. It explains them if it has score 1 at the end of each and was
not solved at the start. Prior: every choice in writing a program down is uniform over what the
language allows there, so that its probability is 2 to the minus its bits.
"""

import argparse
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from magical.experts.rollout import rollout
from magical.scene import Poses, Scene
from magical.tasks import TASKS, get_task
from magical.tasks.scoring import SUCCESS
from magical_goals.language import parsing
from magical_goals.language.expressions import (
    AllBut,
    And,
    Attribute,
    Beside,
    Expression,
    Or,
    Place,
    Selection,
)
from magical_goals.language.generated import HELD_OUT
from magical_goals.language.goals import (
    Clustered,
    Each,
    Every,
    Exactly,
    Goal,
    Lined,
    OneOf,
    Only,
    RobotInside,
    Together,
    Undisturbed,
)
from magical_goals.language.parsing import simple_expressions
from magical_goals.language.programs import program_of


@dataclass(frozen=True, slots=True)
class Mass:
    """A set of programs: how many, the sum of their weights, and of weight times bits."""

    count: int = 0
    weight: float = 0.0
    bits: float = 0.0

    @staticmethod
    def of(bits: float) -> "Mass":
        """One expression, or a choice in one."""
        return Mass(1, 2.0**-bits, bits * 2.0**-bits)

    def __add__(self, other: "Mass") -> "Mass":
        return Mass(self.count + other.count, self.weight + other.weight, self.bits + other.bits)

    def __mul__(self, other: "Mass") -> "Mass":
        """All pairs of a part of either set."""
        bits = self.bits * other.weight + self.weight * other.bits
        return Mass(self.count * other.count, self.weight * other.weight, bits)

    @property
    def entropy(self) -> float:
        """Bits that are needed to name one of the programs, by their weights."""
        return self.bits / self.weight + math.log2(self.weight) if self.weight else 0.0


def part(expression: Expression) -> Mass:
    """The choice of an expression and of its words."""
    return Mass.of(parsing.bits_of_part(expression))


def choice(kind: type[Expression]) -> Mass:
    """The choice of a selection, a place or a goal."""
    return Mass.of(parsing.choice(kind))


def selections(scene: Scene) -> Mapping[frozenset[int], tuple[Selection, Mass]]:
    """Selections of at most two parts by the blocks that they select, with one of each."""
    single = list(simple_expressions(Selection))
    masses = {s: part(s) for s in single}
    found: dict[frozenset[int], tuple[Selection, Mass]] = {}

    def add(selection: Selection, mass: Mass) -> None:
        blocks = selection.blocks(scene)
        if blocks:
            first, known = found.get(blocks, (selection, Mass()))
            found[blocks] = first, known + mass

    for selection in single:
        add(selection, masses[selection])
        add(AllBut(selection), choice(AllBut) * masses[selection])
    for a, b in product(single, repeat=2):
        if a.blocks(scene) and b.blocks(scene):
            for kind in (And, Or):
                add(kind(a, b), choice(kind) * masses[a] * masses[b])
    return found


def goals(scene: Scene) -> Iterator[tuple[Goal, Mass]]:
    """Goals of one part, one of each meaning, with all that mean the same in this scene."""
    chosen = selections(scene).values()
    places: list[tuple[Place, Mass]] = [(p, part(p)) for p in simple_expressions(Place)]
    places += [(Beside(s), choice(Beside) * mass) for s, mass in chosen]
    for kind in (Each, Every, OneOf):
        for (selection, mass), (place, place_mass) in product(chosen, places):
            yield kind(selection, place), choice(kind) * mass * place_mass
    for simple_kind in (Exactly, Only, Undisturbed, Lined):
        yield from ((simple_kind(s), choice(simple_kind) * mass) for s, mass in chosen)
    if len(scene.blocks) > 1:
        for goal in (Clustered(attribute) for attribute in Attribute):
            yield goal, part(goal)
    if scene.regions:
        yield RobotInside(), choice(RobotInside)


def explanations(scene: Scene, ends: Sequence[Poses]) -> tuple[Mass, Mass]:
    """The programs of one goal, and of two together, that explain the final states."""
    start = Poses.at_rest(scene)
    by_start: dict[float, Mass] = defaultdict(Mass)  # score at the start -> goals that end at 1
    for goal, mass in goals(scene):
        if all(goal.score(scene, poses) >= 1.0 for poses in ends):
            by_start[round(goal.score(scene, start), 6)] += mass
    single = _sum(mass for score, mass in by_start.items() if score <= SUCCESS)
    both = _sum(a * b for (x, a), (y, b) in product(by_start.items(), repeat=2) if x * y <= SUCCESS)
    return single, choice(Together) * both


def _sum(masses: Iterable[Mass]) -> Mass:
    total = Mass()
    for mass in masses:
        total += mass
    return total


def row(name: str, demonstrations: int) -> str:
    """A scene's line in the table."""
    task = get_task(name)
    episodes = [rollout(name, "Demo", seed) for seed in range(demonstrations)]
    solved = [Poses(episode.poses[-1]) for episode in episodes if episode.score >= 1.0]
    single, both = explanations(task.demo, solved)
    all_of_them = single + both
    bits = sum(map(parsing.bits_of_part, program_of(name).parts))
    truth = 2.0**-bits / all_of_them.weight if all_of_them.weight else 0.0
    return (
        f"| {name} | {len(solved)} | {single.count:,} | {all_of_them.count:,} | "
        f"{all_of_them.entropy:.1f} | {bits:.1f} | {truth:.1e} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--generated", type=int, default=0, help="held-out tasks besides")
    args = parser.parse_args()
    names = [name for name, task in TASKS.items() if task.section]
    names += HELD_OUT[: args.generated]
    print("| Demo scene | of 1 or 10 demos, with score 1 | programs of one goal ", end="")
    print("| of one or two | entropy | own bits | own p |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, demonstrations in product(names, (1, 10)):
        print(row(name, demonstrations), flush=True)


if __name__ == "__main__":
    main()
