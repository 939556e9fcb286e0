"""Environment ids: `magical/<Task>-<Variant>[-<Preset>]-v0`."""

from collections.abc import Iterator
from typing import NamedTuple

from magical.errors import UnknownNameError
from magical.observe.spec import PRESETS
from magical.tasks import TASKS, Task, get_task

NAMESPACE = "magical"
VERSION = "v0"


class EnvId(NamedTuple):
    """An environment id taken apart."""

    task: str
    variant: str
    preset: str | None = None

    def __str__(self) -> str:
        words = [self.task, self.variant, *([self.preset] if self.preset else []), VERSION]
        return f"{NAMESPACE}/{'-'.join(words)}"


def parse_env_id(env_id: str) -> EnvId:
    """Take an id apart (the leading `magical/` may be missing).

    Raises `UnknownNameError` naming the unknown part and what there is instead.
    """
    name = env_id.removeprefix(f"{NAMESPACE}/")
    task_name, *rest = name.split("-")
    if not 2 <= len(rest) <= 3 or rest[-1] != VERSION:
        raise UnknownNameError(
            f"environment id {env_id!r}: expected {NAMESPACE}/<Task>-<Variant>[-<Preset>]-{VERSION}"
        )
    task = get_task(task_name)
    task.axes_of(rest[0])  # raises for a variant that the task lacks
    preset = rest[1] if len(rest) == 3 else None
    if preset is not None and preset not in PRESETS:
        raise UnknownNameError(
            f"environment id {env_id!r}: preset {preset!r} is unknown; expected one of: "
            f"{', '.join(PRESETS)}"
        )
    return EnvId(task.name, rest[0], preset)


def task_env_ids(task: Task) -> Iterator[EnvId]:
    """Every id of one task: its variants, each without and with every preset."""
    for variant in task.variants:
        for preset in (None, *PRESETS):
            yield EnvId(task.name, variant, preset)


def all_env_ids(presets: bool = False) -> list[str]:
    """The ids of all tasks and variants; with `presets`, those with presets as well."""
    ids = (env_id for task in TASKS.values() for env_id in task_env_ids(task))
    return [str(env_id) for env_id in ids if presets or env_id.preset is None]
