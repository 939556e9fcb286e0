"""Variants by their names in tables: `Jitter` for `TestJitter`."""

from collections.abc import Iterable

from magical.errors import UnknownNameError
from magical.tasks import VARIANTS, Task

PREFIX = "Test"


def short_variant(variant: str) -> str:
    """A variant's name in tables, for instance `Jitter` for `TestJitter`."""
    return variant.removeprefix(PREFIX)


SHORT_VARIANTS = tuple(map(short_variant, VARIANTS))  # Demo, Jitter, Layout, ...


def full_variant(variant: str) -> str:
    """A variant's name in environment ids, from either name; raises `UnknownNameError`."""
    for name in VARIANTS:
        if variant in (name, short_variant(name)):
            return name
    raise UnknownNameError(
        f"{variant!r} is not a variant; expected some of: {', '.join(SHORT_VARIANTS)}"
    )


def variants_of(task: Task, chosen: Iterable[str] | None = None) -> tuple[str, ...]:
    """The chosen variants that the task has, in the tables' order; all of them for `None`.

    Raises `UnknownNameError` for a name that is no variant, or where the task has none of them.
    """
    if chosen is None:
        return task.variants
    wanted = [full_variant(name) for name in chosen]
    variants = tuple(name for name in task.variants if name in wanted)
    if not variants:
        known = ", ".join(map(short_variant, task.variants))
        raise UnknownNameError(
            f"{task.name} has none of the variants {', '.join(wanted)}; it has: {known}"
        )
    return variants
