"""English for selected blocks: by visible attributes, or by the relation that selects them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from magical.scene import Scene
from magical.tasks.programs.expressions import Attribute
from magical.tasks.programs.selections import AllBlocks, Blocks, Enclosed, Selection, value_of

NUMBERS = ("no", "the", "both", "the three", "the four", "the five", "the six")


@dataclass(frozen=True, slots=True)
class Style:
    """How an instruction is worded.

    Attributes:
        paraphrase: index of the wording.
        attributes: whether blocks and regions are named by their colours and shapes.
    """

    paraphrase: int = 0
    attributes: bool = True

    def of(self, choices: Sequence[str]) -> str:
        """The choice that belongs to this paraphrase."""
        return choices[self.paraphrase % len(choices)]


def describe(selection: Selection, scene: Scene, style: Style) -> str:
    """A selection in English, such as "the red star and both blue circles".

    Blocks that attributes do not distinguish, and all blocks if attributes are left out, are
    described by the relation that selects them, such as "the block nearest to the region".
    """
    chosen = selection.blocks(scene)
    several_of_all = isinstance(selection, AllBlocks) and len(chosen) > 1
    if not style.attributes or several_of_all:
        return selection.phrase if len(scene.blocks) > 1 else "the block"
    names = _names(chosen, scene)
    return join(names) if names else selection.phrase


def join(phrases: Sequence[str]) -> str:
    """Phrases as a list in English: "a", "a and b", "a, b and c"."""
    return " and ".join([", ".join(phrases[:-1]), phrases[-1]] if len(phrases) > 1 else phrases)


def _names(chosen: Blocks, scene: Scene) -> list[str] | None:
    """Each kind of the chosen blocks, distinguished from all others; `None` if it cannot be."""
    kinds = [value_of(block, Attribute.KIND) for block in scene.blocks]
    enclosed = Enclosed().blocks(scene)
    names = []
    for kind, count in Counter(kinds[i] for i in sorted(chosen)).items():
        alike = {i for i, other in enumerate(kinds) if other == kind}
        where = _where(alike & chosen, alike - chosen, enclosed)
        if where is None or count >= len(NUMBERS):
            return None
        plural = "s" if count > 1 else ""
        names.append(f"{NUMBERS[count]} {kind}{plural}{where}")
    return names


def _where(chosen: set[int], others: set[int], enclosed: Blocks) -> str | None:
    """What distinguishes chosen blocks from others of their kind; `None` if nothing does."""
    if not others:
        return ""
    verb = "are" if len(chosen) > 1 else "is"
    if chosen <= enclosed and not others & enclosed:
        return f" that {verb} inside"
    if others <= enclosed and not chosen & enclosed:
        return f" that {verb} outside"
    return None


def name_regions(scene: Scene, style: Style, article: str = "a") -> str:
    """The scene's regions in English: "the blue region", or `article` "region" if not just one."""
    if len(scene.regions) != 1:
        return f"{article} region"
    colour = f"{scene.regions[0].colour} " if style.attributes else ""
    return f"the {colour}region"


def stay(what: str, blocks: Blocks) -> str:
    """Where blocks, described as `what`, should stay, in English."""
    return "where it is" if len(blocks) == 1 or what.startswith("every") else "where they are"
