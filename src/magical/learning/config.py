"""What the configurations of all algorithms share: options, presets, conversion to plain data.

The configuration of an algorithm is one frozen dataclass: its fields are the command line's
options, the Python signature, and the record in the run folder. Defaults are the published
settings. Nothing here needs PyTorch.
"""

import dataclasses
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

from magical.errors import InvalidConfigError, UnknownNameError
from magical.learning.augmentation.names import BORDERS, Augmentations, parse_augmentations
from magical.learning.networks import network_names
from magical.observe import PRESETS, ObservationSpec, make_spec
from magical.runs.sources import DEMONSTRATIONS
from magical.tasks import get_task

DEVICES = ("auto", "cpu", "cuda")
PRECISIONS = ("auto", "float32", "bfloat16")
PIXEL_RANGES = {"unit": (0.0, 1.0), "symmetric": (-1.0, 1.0)}
AUTO, RENDERING, RESAMPLING = "auto", "rendering", "resampling"  # how images are augmented
LAST_LAYER_INITS = ("default", "normal")
IMAGE_OBSERVATIONS = tuple(name for name, spec in PRESETS.items() if not spec.separate)

# What the published code does in all algorithms, where it differs from the appendix
# (docs/specification.md, section 11; docs/presets.md).
PUBLISHED_CODE_IMAGES: Mapping[str, Any] = {
    "pixel_range": "symmetric",
    "last_layer_init": "normal",
    "borders": "repeat",
    "linear_light": False,
}

CHECKPOINT_SECONDS = 30  # between checkpoints, unless a number of steps is configured

METAVARS = {int: "N", float: "X", str: "NAME", bool: None}


def option(
    default: Any,
    text: str,
    *,
    choices: tuple[str, ...] | Callable[[], tuple[str, ...]] = (),
    metavar: str | None = None,
    added: bool = False,
) -> Any:
    """A configuration field.

    Args:
        default: the published setting.
        text: a line of help for the command line.
        choices: the allowed values, if there are only a few, or a function that finds them.
        metavar: what stands for the value in the command line's help.
        added: older runs lack the field, and did what the default does.
    """
    metadata = {"help": text, "choices": choices, "metavar": metavar, "added": added}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of every algorithm."""

    algorithm: ClassVar[str]
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {}}
    # Seconds of a core for a sample in training and for an action, where no network of the
    # registry decides on them; only to estimate the time of a run.
    seconds_each: ClassVar[tuple[float, float] | None] = None
    # Fields of this class and others above that mean nothing to an algorithm: no options of it.
    without: ClassVar[tuple[str, ...]] = ()

    tasks: tuple[str, ...] = option(
        dataclasses.MISSING, "tasks to learn, one or several", metavar="TASK"
    )
    observation: str = option("LoRes4E", "observation preset", choices=IMAGE_OBSERVATIONS)
    seed: int = option(0, "determines demonstrations, initialisation, minibatches and episodes")
    network: str = option("paper", "network architecture", choices=network_names)
    pixel_range: str = option(
        "unit",
        "of the networks' images: [0, 1] or [-1, 1]",
        choices=tuple(PIXEL_RANGES),
        added=True,
    )
    last_layer_init: str = option(
        "default",
        "initialisation of the last layers: the other layers', or N(0, 1)",
        choices=LAST_LAYER_INITS,
        added=True,
    )
    device: str = option("auto", "where to compute", choices=DEVICES)
    # PPO compares ratios with a clip range of 0.01: bfloat16's resolution is nearly as coarse.
    precision: str = option(
        "float32",
        "of the forward and backward pass; auto: bfloat16 where the processor has it",
        choices=PRECISIONS,
    )
    threads: int = option(0, "CPU threads; 0: PyTorch's own number")
    compile: bool = option(False, "compile the networks (torch.compile)")
    graphs: str = option(
        "auto",
        "record training steps as CUDA graphs; auto: on a GPU",
        choices=("auto", "on", "off"),
        added=True,
    )

    def __post_init__(self) -> None:
        if isinstance(self.tasks, str):
            object.__setattr__(self, "tasks", (self.tasks,))
        names = tuple(get_task(name).name for name in self.tasks)
        object.__setattr__(self, "tasks", names)
        if not names or len(set(names)) < len(names):
            raise InvalidConfigError(f"tasks: expected each task once, found {names}")
        if self.seed < 0:
            raise InvalidConfigError(f"seed: expected at least 0, found {self.seed}")
        self.require_at_least_zero("threads")
        self._require_choices()
        for name in self.without:
            default = type(self).__dataclass_fields__[name].default
            if getattr(self, name) != default:
                raise InvalidConfigError(
                    f"{name}: {self.algorithm} has no such setting; expected the default "
                    f"{default!r}, found {getattr(self, name)!r}"
                )

    @property
    def learned_from(self) -> tuple[str, ...]:
        """What is learned from, in the words of `magical.runs.sources`."""
        return ()

    def _require_choices(self) -> None:
        for field in dataclasses.fields(self):
            choices, value = _choices(field), getattr(self, field.name)
            if choices and value not in choices:
                raise UnknownNameError(
                    f"{field.name} {value!r} is unknown; expected one of: {', '.join(choices)}"
                )

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

    def require_positive(self, *names: str) -> None:
        """Raise `InvalidConfigError` unless the named numbers are above 0."""
        for name in names:
            if not getattr(self, name) > 0:
                raise InvalidConfigError(
                    f"{name}: expected a number above 0, found {getattr(self, name)}"
                )

    def require_at_least_zero(self, *names: str) -> None:
        """Raise `InvalidConfigError` unless the named numbers are at least 0 (or `None`)."""
        for name in names:
            if (getattr(self, name) or 0) < 0:
                raise InvalidConfigError(
                    f"{name}: expected at least 0, found {getattr(self, name)}"
                )

    def require_fraction(self, *names: str) -> None:
        """Raise `InvalidConfigError` unless the named numbers are from 0 to 1."""
        for name in names:
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidConfigError(
                    f"{name}: expected a number from 0 to 1, found {getattr(self, name)}"
                )

    def require_augmentations(self, *names: str) -> None:
        """Raise `UnknownNameError` unless the named fields are sets of augmentations."""
        for name in names:
            parse_augmentations(getattr(self, name))

    def require_one_task(self) -> None:
        """Raise `InvalidConfigError` for several tasks."""
        if len(self.tasks) > 1:
            raise InvalidConfigError(
                f"{self.algorithm}: expected one task (it is not defined for several), found "
                f"{', '.join(self.tasks)}; use gail, or a run for each task"
            )

    @property
    def total(self) -> int:
        """The number of steps (batches or updates) of a whole run."""
        raise NotImplementedError

    @property
    def training_samples(self) -> int:
        """The samples of all forward and backward passes of a whole run, to estimate its time."""
        raise NotImplementedError

    @property
    def observation_spec(self) -> ObservationSpec:
        """The observation's specification; the same for all tasks."""
        return make_spec(self.observation, get_task(self.tasks[0]))

    @property
    def input_shape(self) -> tuple[int, ...]:
        """The shape of one observation as a network input."""
        return self.observation_spec.network_shape

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        plain = {"algorithm": self.algorithm, **dataclasses.asdict(self)}
        return {name: list(v) if isinstance(v, tuple) else v for name, v in plain.items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The inverse of `to_dict`; fields that older runs lack get their defaults.

        Raises `InvalidConfigError` for other missing fields, and for unknown ones.
        """
        fields = {name: value for name, value in data.items() if name != "algorithm"}
        known = {field.name for field in dataclasses.fields(cls)}
        added = {field.name for field in dataclasses.fields(cls) if field.metadata["added"]}
        odd = sorted((set(fields) ^ known) - (added - set(fields)))
        if odd or data.get("algorithm") != cls.algorithm:
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

    demos: str = option(
        dataclasses.MISSING, "folder with a dataset of demonstrations", metavar="FOLDER"
    )
    num_demos: int = option(10, "demonstrations of each task, sampled by the seed")
    augment: str = option(
        "all", "augmentation: all, none, no-trans-rot, or names joined by +", metavar="NAMES"
    )
    borders: str = option(
        "mirror", "how augmented images go on beyond their borders", choices=BORDERS, added=True
    )
    linear_light: bool = option(
        True, "convert sRGB to linear light for the colour jitter", added=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("num_demos")
        self.require_augmentations("augment")

    @property
    def augmentations(self) -> Augmentations:
        """The augmentations of images."""
        return parse_augmentations(self.augment, self.borders, self.linear_light)

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        return (*super().learned_from, DEMONSTRATIONS)


@dataclass(frozen=True, slots=True)
class Option:
    """A configuration field as an option of the command line."""

    name: str
    kind: type
    several: bool
    required: bool
    default: Any
    help: str
    choices: tuple[str, ...]
    metavar: str | None

    @property
    def flag(self) -> str:
        """For instance `--num-demos`."""
        return "--" + self.name.replace("_", "-")


def options(kind: type[Config]) -> list[Option]:
    """The options of a configuration class: required ones first, then in the fields' order."""
    hints = get_type_hints(kind)
    fields = (field for field in dataclasses.fields(kind) if field.name not in kind.without)
    found = [_option(field, hints[field.name]) for field in fields]
    return sorted(found, key=lambda option: not option.required)


def _choices(field: "dataclasses.Field[Any]") -> tuple[str, ...]:
    choices = field.metadata["choices"]
    found: tuple[str, ...] = choices() if callable(choices) else choices
    return found


def _option(field: "dataclasses.Field[Any]", hint: Any) -> Option:
    several = get_origin(hint) is tuple
    if several or isinstance(hint, types.UnionType):  # tuple[str, ...] or int | None
        hint = next(kind for kind in get_args(hint) if kind not in (Ellipsis, types.NoneType))
    required = field.default is dataclasses.MISSING
    default = None if required else field.default
    text, choices = field.metadata["help"], _choices(field)
    metavar = None if choices else field.metadata["metavar"] or METAVARS[hint]
    return Option(field.name, hint, several, required, default, text, choices, metavar)
