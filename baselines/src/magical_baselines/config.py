"""Configurations, and the algorithms they belong to. Nothing here needs PyTorch.

An algorithm's configuration is a frozen dataclass. Its fields are the options of `magical train`,
the settings of presets and plans, and what `config.json` records. Defaults are the published
settings. The base classes here hold the options that several algorithms share.
"""

import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from msgspec import Meta

from magical.errors import InvalidConfigError, RunFolderError, UnknownNameError
from magical.files import convert
from magical.messages import quoted
from magical.observe import GROUP as OBSERVATIONS
from magical.observe import PRESETS, STATE, ObservationSpec, make_spec
from magical.plugins import Registry, is_plugin, plugins, require_imported
from magical.runs import CONFIG, DEMONSTRATIONS, LEARNED_FROM, NUM_DEMOS, is_run, read_json
from magical.tasks import get_task
from magical_baselines.augmentation.names import Augmentations, parse_augmentations
from magical_baselines.networks import GROUP as NETWORKS
from magical_baselines.networks import sources_of

if TYPE_CHECKING:
    from torch import nn

    from magical_baselines.policy import TrainedPolicy
    from magical_baselines.training import Run

PositiveInt = Annotated[int, Meta(ge=1)]
NonNegativeInt = Annotated[int, Meta(ge=0)]
PositiveFloat = Annotated[float, Meta(gt=0)]
NonNegativeFloat = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Field = dataclasses.Field[Any]

IMAGE_OBSERVATIONS = tuple(name for name, spec in PRESETS.items() if not spec.separate)
MAX_THREADS = 4096  # of a CPU
CHECKPOINT_SECONDS = 30  # between checkpoints, unless a number of steps is configured


def option(
    default: Any,
    text: str,
    *,
    metavar: str = "",
    plugins: str = "",
    known: tuple[str, ...] = (),
    parse: Callable[[str], object] | None = None,
) -> Any:
    """A configuration field.

    Args:
        default: the published setting; `MISSING` if one has to be given.
        text: one line of command-line help.
        metavar: the value's placeholder in the help.
        plugins: the group of entry points whose names are allowed, as is `module:NAME`.
        known: other names that are allowed.
        parse: called with the value; raises an error unless it is allowed.
    """
    how = {"help": text, "metavar": metavar, "plugins": plugins, "known": known, "parse": parse}
    return dataclasses.field(default=default, metadata=how)


def augment_option(default: str, images: str = "images") -> Any:
    """A configuration field for the names of the augmentations applied to some images."""
    text = f"augmentations of {images}: all, none, no-trans-rot, or names joined by +"
    return option(default, text, parse=parse_augmentations, metavar="NAMES")


@dataclass(frozen=True, kw_only=True)
class Config:
    """Options common to all algorithms.

    Paths are converted to strings, NumPy's numbers to Python's, and for tuple fields any iterable
    or a single string to a tuple, so that a configuration can be written as JSON.
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {}}
    # The observations of this package that the algorithm accepts.
    observations: ClassVar[tuple[str, ...]] = IMAGE_OBSERVATIONS

    algorithm: str = ""  # its name, an entry point's name, or `module:NAME`
    tasks: tuple[str, ...] = option(MISSING, "one or more tasks to learn", metavar="TASK")
    seed: NonNegativeInt = option(
        0, "random seed of demonstrations, initialisation, minibatches and episodes"
    )
    device: Literal["auto", "cpu", "cuda"] = option("auto", "device to compute on")
    # PPO compares ratios with a clip range of 0.01: bfloat16's resolution is nearly as coarse.
    precision: Literal["auto", "float32", "bfloat16"] = option(
        "float32",
        "precision of forward and backward passes; auto: bfloat16 if the processor supports it",
    )
    threads: Annotated[int, Meta(ge=0, le=MAX_THREADS)] = option(
        0, "CPU threads; 0: PyTorch's default, or 1 for state vectors in environments"
    )
    checkpoint_every: NonNegativeInt = option(
        0, f"batches or updates between checkpoints; 0: at most one every {CHECKPOINT_SECONDS} s"
    )

    def __post_init__(self) -> None:
        hints = type_hints(type(self))
        for field in options(type(self)):
            value = _plain(getattr(self, field.name), hints[field.name])
            choices = get_args(hints[field.name])
            if get_origin(hints[field.name]) is Literal and value not in choices:
                expected = ", ".join(map(quoted, choices))
                text = f"{field.name}: expected one of {expected}, found {quoted(value)}"
                raise InvalidConfigError(text)
            value = convert(value, hints[field.name], field.name, InvalidConfigError)
            object.__setattr__(self, field.name, value)
            if field.metadata["parse"]:
                field.metadata["parse"](value)
            group, known = field.metadata["plugins"], field.metadata["known"]
            if group and value not in known and not is_plugin(group, value):
                raise _unknown(field.name, value, [*known, *sorted(plugins(group))])
        names = tuple(get_task(name).name for name in self.tasks)
        object.__setattr__(self, "tasks", names)
        if not names or len(set(names)) < len(names):
            raise InvalidConfigError(f"tasks: expected each task once, found {names}")

    @property
    def learned_from(self) -> tuple[str, ...]:
        """What the run learns from, in the terms of `magical.runs`."""
        return ()

    @property
    def training_details(self) -> dict[str, Any]:
        """How a policy is trained, as entries record it (docs/protocol.md)."""
        sources = list(dict.fromkeys(self.learned_from))
        return {"algorithm": self.algorithm, "training_seed": self.seed, LEARNED_FROM: sources}

    @property
    def num_updates(self) -> int:
        """The number of steps (batches or updates) in a whole run; every subclass defines it."""
        raise NotImplementedError(f"{type(self).__name__} defines no num_updates")

    @property
    def num_threads(self) -> int:
        """CPU threads to train with; 0: PyTorch's default."""
        return self.threads

    @property
    def observation(self) -> str:
        raise NotImplementedError(f"{type(self).__name__} defines no observation")

    @property
    def action_space(self) -> Literal["discrete", "continuous"]:
        """The action space of the policy, to which the actions of demonstrations are converted."""
        return "discrete"

    @property
    def observation_spec(self) -> ObservationSpec:
        """The observation's specification; the same for all tasks."""
        return make_spec(self.observation, get_task(self.tasks[0]))

    @property
    def input_shape(self) -> tuple[int, ...]:
        return self.observation_spec.network_shape

    @property
    def observes_vectors(self) -> bool:
        return len(self.input_shape) == 1

    @property
    def network_precision(self) -> str:
        """`precision`, but `auto` means float32 for state vectors, which need more digits."""
        exact = self.precision == "auto" and self.observes_vectors
        return "float32" if exact else self.precision

    def require_one_task(self) -> None:
        """Raise `InvalidConfigError` if there are several tasks."""
        if len(self.tasks) > 1:
            raise InvalidConfigError(
                f"{self.algorithm}: expected one task (it is not defined for several), found "
                f"{', '.join(self.tasks)}; use gail, or a run for each task"
            )

    @classmethod
    def preset(cls, name: str, /, **settings: Any) -> Self:
        """The configuration of a preset, with some settings replaced.

        Raises `UnknownNameError` or `InvalidConfigError`.
        """
        if name not in cls.presets:
            raise UnknownNameError(
                f"preset {name!r} is unknown; {cls.algorithm} has: {', '.join(cls.presets)}"
            )
        return cls._of({**cls.presets[name], **settings})

    @classmethod
    def _of(cls, settings: Mapping[str, Any]) -> Self:
        known = {field.name: field for field in options(cls)}
        for name in settings:
            if name not in known and name != "algorithm":
                raise _unknown("setting", name, known)
        for name, field in known.items():
            if field.default is MISSING and name not in settings:
                raise InvalidConfigError(f"expected the setting {name}, found none")
        return cls(**settings)

    def replace(self, **settings: Any) -> Self:
        return self._of({**self.to_dict(), **settings})

    def to_dict(self) -> dict[str, Any]:
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {k: list(value) if isinstance(value, tuple) else value for k, value in plain.items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], what: str = "configuration") -> Self:
        """The inverse of `to_dict`; raises `InvalidConfigError`, which begins with `what`."""
        try:
            return cls._of(data)
        except ValueError as error:
            raise InvalidConfigError(f"{what}: {error}") from error


# The types of a class's fields, cached: each call would evaluate every annotation again.
type_hints: Callable[[Any], dict[str, Any]] = cache(partial(get_type_hints, include_extras=True))


def options(kind: type[Config]) -> list[Field]:
    """All fields but `algorithm`, each made by `option`."""
    return [field for field in dataclasses.fields(kind) if field.name != "algorithm"]


def _plain(value: Any, hint: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if get_origin(hint) is not tuple or not isinstance(value, Iterable):
        return value
    return (value,) if isinstance(value, str) else tuple(value)


def _unknown(what: str, name: str, known: Iterable[str]) -> UnknownNameError:
    text = f"{what} {quoted(name)} is unknown; expected one of: {', '.join(known)}"
    return UnknownNameError(text if what == "setting" else f"{text}; or module:NAME")


@dataclass(frozen=True, kw_only=True)
class NetworkConfig(Config):
    """Options of algorithms whose network is one of the registry."""

    observation: str = option(
        "LoRes4E", "observation preset", plugins=OBSERVATIONS, known=(*PRESETS, STATE)
    )
    network: str = option("paper", "network architecture", plugins=NETWORKS)

    def __post_init__(self) -> None:
        super().__post_init__()
        name = self.observation
        if name not in self.observations and not is_plugin(OBSERVATIONS, name):
            raise UnknownNameError(
                f"observation {quoted(name)} is not taken by {self.algorithm}; expected one of: "
                f"{', '.join(self.observations)}"
            )
        if STATE not in self.observations and self.observes_vectors:
            raise InvalidConfigError(
                f"observation: {self.algorithm} learns from images, found a vector"
            )
        if len({make_spec(name, get_task(task)).network_shape for task in self.tasks}) > 1:
            raise InvalidConfigError(
                "observation: state vectors differ between tasks, so one task is expected, found "
                f"{', '.join(self.tasks)}; use a pixel observation, or a run for each task"
            )

    @property
    def learned_from(self) -> tuple[str, ...]:
        return (*super().learned_from, *sources_of(self.network))

    def augmentations(self, names: str) -> Augmentations:
        """The augmentations with these names."""
        return parse_augmentations(names)


@dataclass(frozen=True, kw_only=True)
class PaperNetworkConfig(NetworkConfig):
    """Options of algorithms with the paper's networks."""

    conventions: Literal["appendix", "published"] = option(
        "appendix",
        "whether images, initialisation and batch norm follow the appendix or the published code "
        "(docs/baselines.md)",
    )

    @property
    def published(self) -> bool:
        return self.conventions == "published"

    @property
    def pixel_range(self) -> tuple[float, float]:
        """The range that networks map the pixels of images to."""
        return (-1.0, 1.0) if self.published else (0.0, 1.0)

    @property
    def action_input(self) -> str:
        """How reward networks take actions as input, a key of `magical_baselines.models.JOINED`."""
        return "embedding" if self.published else "one-hot"

    def augmentations(self, names: str) -> Augmentations:
        """The augmentations with these names, with borders and colours as in the conventions."""
        chosen = super().augmentations(names)
        if self.published:
            return dataclasses.replace(chosen, borders="repeat", linear_light=False)
        return chosen


@dataclass(frozen=True, kw_only=True)
class DemonstrationConfig(Config):
    """Options of algorithms that learn from demonstrations."""

    demos: str = option(MISSING, "folder with a dataset of demonstrations", metavar="FOLDER")
    num_demos: PositiveInt = option(10, "demonstrations per task, chosen by the seed")

    @property
    def learned_from(self) -> tuple[str, ...]:
        return (DEMONSTRATIONS, *super().learned_from)

    @property
    def training_details(self) -> dict[str, Any]:
        found = {"demonstrations": f"{self.num_demos} of each task", NUM_DEMOS: self.num_demos}
        return {**super().training_details, **found}


@dataclass(frozen=True, kw_only=True)
class SupervisedConfig(DemonstrationConfig):
    """Options of algorithms that `magical_baselines.training.fit` trains."""

    batches: PositiveInt = option(20_000, "training batches")
    batch_size: PositiveInt = option(32, "samples per batch")
    log_every: PositiveInt = option(50, "batches between logged metrics")

    @property
    def num_updates(self) -> int:
        """The number of batches."""
        return self.batches


@dataclass(frozen=True, slots=True)
class Algorithm:
    """What the file of an algorithm provides.

    Attributes:
        config: the configuration class.
        train: called as `train(config, run)`; trains, logs, and saves checkpoints whose part
            `policy` is the module that `make_policy` returns.
        make_policy: a function from the configuration to a module that maps observations (B, ...)
            and tasks (B,) to logits (B, 18), or to whatever `policy` expects.
        policy: the class of the policy that acts with this module; `None` for `NetworkPolicy`.
    """

    config: type[Config]
    train: "Callable[[Any, Run], None]"
    make_policy: "Callable[[Any], nn.Module]"
    policy: "type[TrainedPolicy] | None" = None


_ALGORITHMS = Registry("algorithm", Algorithm, "magical.algorithms")


def algorithm_names() -> list[str]:
    """The names of all algorithms, including other distributions', sorted; imports none."""
    return _ALGORITHMS.names()


def find_algorithm(name: str) -> Algorithm:
    """An algorithm by name, or by `module:NAME`.

    Raises `UnknownNameError` or `PluginError`.
    """
    return _ALGORITHMS.get(name)


def read_config(folder: Path | str, given: Mapping[str, Any] = MappingProxyType({})) -> Config:
    """The configuration recorded in a run folder.

    Args:
        folder: the run folder.
        given: settings that the user has named, too; their modules may be imported.

    Raises:
        RunFolderError: the record is missing, damaged, or names an unknown algorithm.
        PluginError: the record names an object of a module that the user has not imported.
        InvalidConfigError: the settings are invalid.
    """
    path = Path(folder) / CONFIG
    if not is_run(folder):
        raise RunFolderError(f"{folder}: expected a run folder with {CONFIG}, found none")
    data = read_json(path)
    algorithm = data.get("algorithm")
    if not isinstance(algorithm, str):
        raise RunFolderError(f"{path}: expected the name of an algorithm, found none")
    require_imported(algorithm, str(path))
    try:
        kind = find_algorithm(algorithm).config
    except UnknownNameError as error:
        raise RunFolderError(f"{path}: {error}") from error
    for name in references(kind, data):
        if name not in given.values():
            require_imported(name, str(path))
    return kind.from_dict(data, str(path))


def references(kind: type[Config], settings: Mapping[str, Any]) -> list[str]:
    """The `module:NAME` among the settings of a configuration class."""
    values = (settings.get(o.name) for o in options(kind) if o.metadata["plugins"])
    return [value for value in values if isinstance(value, str) and ":" in value]


def modules_of(config: Config) -> list[str]:
    """What `--import` must name before another process may read the run of a configuration."""
    names = [config.algorithm, *references(type(config), config.to_dict())]
    return list(dict.fromkeys(name.rpartition(":")[0] for name in names if ":" in name))
