"""Environment ids: `magical/<Task>-<Variant>[-<Preset>]-v0`."""

import re
from typing import Self

from magical.errors import UnknownNameError
from magical.messages import quoted
from magical.observe.presets import PRESETS
from magical.tasks import Task, get_task, importable_tasks

NAMESPACE = "magical"
VERSION = "v0"


class EnvId(str):
    """An environment id: a string with its parts as attributes.

    It is made once, by `parse_env_id`, where a string enters the package, and then passed on
    unchanged; being a string, it prints, compares and serialises like the id itself.

    Attributes:
        task: the task's name.
        variant: the variant's name, such as `Demo` or `TestJitter`.
        preset: the observation preset's name, or `None`.
    """

    __slots__ = ("preset", "task", "variant")

    task: str
    variant: str
    preset: str | None

    def __new__(cls, task: str, variant: str, preset: str | None = None) -> Self:
        """Join the parts; the names are not checked."""
        parts = (task, variant, *([preset] if preset else []), VERSION)
        self = super().__new__(cls, f"{NAMESPACE}/{'-'.join(parts)}")
        self.task, self.variant, self.preset = task, variant, preset
        return self

    def __reduce__(self) -> tuple[type["EnvId"], tuple[str, str, str | None]]:
        return EnvId, (self.task, self.variant, self.preset)

    @property
    def without_preset(self) -> "EnvId":
        """The id of the same task and variant without a preset."""
        return self if self.preset is None else EnvId(self.task, self.variant)

    @property
    def task_spec(self) -> Task:
        """The task itself; raises `UnknownNameError` if it is not registered."""
        return get_task(self.task)


def split_env_id(env_id: str) -> EnvId:
    """Split an id without checking its names (the leading `magical/` may be missing).

    Raises `UnknownNameError` for text in another format.
    """
    if isinstance(env_id, EnvId):
        return env_id
    task, *rest = str(env_id).removeprefix(f"{NAMESPACE}/").split("-")
    if 2 <= len(rest) <= 3 and rest[-1] != VERSION and re.fullmatch(r"v\d+", rest[-1]):
        raise UnknownNameError(
            f"environment id {quoted(env_id)}: version {rest[-1]} is unknown; expected {VERSION}"
        )
    if not 2 <= len(rest) <= 3 or rest[-1] != VERSION:
        raise UnknownNameError(
            f"environment id {quoted(env_id)}: expected "
            f"{NAMESPACE}/<Task>-<Variant>[-<Preset>]-{VERSION}"
        )
    return EnvId(task, rest[0], rest[1] if len(rest) == 3 else None)


def parse_env_id(env_id: str) -> EnvId:
    """Split an id and check its names (the leading `magical/` may be missing).

    An `EnvId` is returned unchanged. Raises `UnknownNameError`, which names the unknown part and
    the alternatives.
    """
    if isinstance(env_id, EnvId):
        return env_id
    parsed = split_env_id(env_id)
    get_task(parsed.task).axes_of(parsed.variant)  # raises for a variant that the task lacks
    if parsed.preset is not None and parsed.preset not in PRESETS:
        raise UnknownNameError(
            f"environment id {quoted(env_id)}: preset {quoted(parsed.preset)} is unknown; "
            f"expected one of: {', '.join(PRESETS)}"
        )
    return parsed


def all_env_ids(presets: bool = False) -> list[EnvId]:
    """The ids of all variants of all importable tasks, except generated tasks.

    With `presets`, the ids with each preset as well.
    """
    return [
        EnvId(task.name, variant, preset)
        for task in importable_tasks()
        for variant in task.variants
        for preset in ((None, *PRESETS) if presets else (None,))
    ]
