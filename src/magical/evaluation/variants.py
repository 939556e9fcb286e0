"""Variants by their names in environment ids or in tables: `TestJitter` or `Jitter`."""

from collections.abc import Iterable

from magical.errors import UnknownNameError
from magical.tasks import Task
from magical.tasks.axes import SHORT_VARIANTS, full_variant, short_variant

__all__ = ["SHORT_VARIANTS", "full_variant", "short_variant", "variants_of"]


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
