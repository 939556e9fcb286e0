"""What all algorithms' configurations share: options, presets, the way to and from plain data.

An algorithm's configuration is one frozen dataclass: its fields are the command line's options, the
Python signature, and the record in the run folder. Defaults are the published settings.
"""

import dataclasses
import types
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

from magical.errors import InvalidConfigError, UnknownNameError
from magical.learning.augment import parse_augmentations
from magical.learning.devices import DEVICES, PRECISIONS
from magical.learning.networks import get_width
from magical.observe import PRESETS, ObservationSpec, make_spec
from magical.tasks import get_task


def option(default: Any, text: str) -> Any:
    """A configuration field with a default and a line of help."""
    return dataclasses.field(default=default, metadata={"help": text})


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of every algorithm."""

    algorithm: ClassVar[str]
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {}}

    tasks: tuple[str, ...] = dataclasses.field(metadata={"help": "tasks to learn, one or several"})
    observation: str = option("LoRes4E", "what the policy sees: a preset's name")
    seed: int = option(0, "chooses the demonstrations, first weights, batches")
    network: str = option("paper", "network: paper, small or light")
    device: str = option("auto", "device: auto, cpu or cuda")
    precision: str = option("auto", "precision: auto (the faster one), float32 or bfloat16")
    compile: bool = option(False, "compile the networks (torch.compile)")

    def __post_init__(self) -> None:
        if isinstance(self.tasks, str):
            object.__setattr__(self, "tasks", (self.tasks,))
        names = tuple(get_task(name).name for name in self.tasks)
        object.__setattr__(self, "tasks", names)
        if not names or len(set(names)) < len(names):
            raise InvalidConfigError(f"tasks: expected each task once, found {names}")
        get_width(self.network)
        self.require_one_of("device", DEVICES)
        self.require_one_of("precision", PRECISIONS)
        if self.seed < 0:
            raise InvalidConfigError(f"seed: expected at least 0, found {self.seed}")
        self.check_observation()

    @classmethod
    def preset(cls, name: str, **fields: Any) -> Self:
        """A preset's settings, some of them replaced.

        Raises `UnknownNameError` for an unknown preset.
        """
        if name not in cls.presets:
            raise UnknownNameError(
                f"preset {name!r} is unknown; {cls.algorithm} has: {', '.join(cls.presets)}"
            )
        return cls(**{**cls.presets[name], **fields})

    def check_observation(self) -> None:
        """Raise unless the observation is one array of images."""
        known = [name for name, spec in PRESETS.items() if not spec.separate]
        if self.observation not in known:
            raise UnknownNameError(
                f"observation {self.observation!r}: expected one of {', '.join(known)}"
            )

    def require_positive(self, *names: str) -> None:
        """Raise `InvalidConfigError` unless the named numbers are above 0."""
        for name in names:
            if not getattr(self, name) > 0:
                raise InvalidConfigError(
                    f"{name}: expected a number above 0, found {getattr(self, name)}"
                )

    def require_one_of(self, name: str, known: tuple[str, ...]) -> None:
        """Raise `UnknownNameError` unless the named field is one of the known words."""
        value = getattr(self, name)
        if value not in known:
            raise UnknownNameError(f"{name} {value!r}: expected one of {', '.join(known)}")

    def require_augmentations(self, *names: str) -> None:
        """Raise `UnknownNameError` unless the named fields say augmentations."""
        for name in names:
            parse_augmentations(getattr(self, name))

    @property
    def total(self) -> int:
        """How many batches or updates a whole run has."""
        raise NotImplementedError

    @property
    def observation_spec(self) -> ObservationSpec:
        """The observation's specification; the same for all tasks."""
        return make_spec(self.observation, get_task(self.tasks[0]))

    @property
    def input_shape(self) -> tuple[int, ...]:
        """The shape of one observation as a network gets it."""
        return self.observation_spec.network_shape

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        plain = {"algorithm": self.algorithm, **dataclasses.asdict(self)}
        return {name: list(v) if isinstance(v, tuple) else v for name, v in plain.items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The inverse of `to_dict`.

        Raises `InvalidConfigError` for missing or unknown fields.
        """
        fields = {name: value for name, value in data.items() if name != "algorithm"}
        known = {field.name for field in dataclasses.fields(cls)}
        if set(fields) != known or data.get("algorithm") != cls.algorithm:
            odd = sorted(set(fields) ^ known)
            raise InvalidConfigError(
                f"expected a configuration of {cls.algorithm}, found one of "
                f"{data.get('algorithm')!r} with other fields: {odd}"
            )
        values: dict[str, Any] = {
            name: tuple(v) if isinstance(v, list) else v for name, v in fields.items()
        }
        return cls(**values)


@dataclass(frozen=True, kw_only=True)
class ImitationConfig(Config):
    """Settings of the algorithms that learn from demonstrations."""

    demos: str = dataclasses.field(metadata={"help": "folder with a dataset of demonstrations"})
    num_demos: int = option(10, "demonstrations of each task, chosen by the seed")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("num_demos")


@dataclass(frozen=True, slots=True)
class Option:
    """A configuration field, as the command line needs it."""

    name: str
    kind: type
    several: bool
    required: bool
    default: Any
    help: str

    @property
    def flag(self) -> str:
        """For instance `--num-demos`."""
        return "--" + self.name.replace("_", "-")


def options(kind: type[Config]) -> list[Option]:
    """The options of a configuration class: those one must give, then in the fields' order."""
    hints = get_type_hints(kind)
    found = [_option(field, hints[field.name]) for field in dataclasses.fields(kind)]
    return sorted(found, key=lambda option: not option.required)


def _option(field: "dataclasses.Field[Any]", hint: Any) -> Option:
    several = get_origin(hint) is tuple
    if several or isinstance(hint, types.UnionType):  # tuple[str, ...] or int | None
        hint = next(kind for kind in get_args(hint) if kind not in (Ellipsis, types.NoneType))
    required = field.default is dataclasses.MISSING
    default = None if required else field.default
    return Option(field.name, hint, several, required, default, field.metadata["help"])
