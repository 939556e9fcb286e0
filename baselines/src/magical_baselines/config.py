"""Configurations: composed of small records, but flat on the command line and in run folders.

An algorithm's configuration is a frozen dataclass. Its own fields and those of its records are the
options on the command line, the settings of `preset` and of plans, and what the run folder records.
Defaults are the published settings. Nothing here needs PyTorch.
"""

import dataclasses
import types
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from typing import Any, ClassVar, Self, get_args, get_origin

from magical.envs.action_spec import ActionSpaceName
from magical.errors import InvalidConfigError, PluginError, UnknownNameError
from magical.messages import quoted
from magical.observe import PRESETS, STATE, ObservationSpec, make_spec
from magical.observe.presets import GROUP
from magical.plugins import is_plugin
from magical.runs.sources import DEMONSTRATIONS, LEARNED_FROM, NUM_DEMOS
from magical.tasks import get_task
from magical_baselines.augmentation.names import Augmentations, parse_augmentations
from magical_baselines.networks import network_names, sources_of
from magical_baselines.settings import (
    DEVICES,
    MAX_THREADS,
    NOT_NEGATIVE,
    POSITIVE,
    Part,
    Settings,
    all_fields,
    by_part,
    default_of,
    name_of,
    option,
    type_hints,
)

APPENDIX, PUBLISHED = "appendix", "published"
CONVENTIONS = (APPENDIX, PUBLISHED)
PIXEL_RANGES = {"unit": (0.0, 1.0), "symmetric": (-1.0, 1.0)}
IMAGE_OBSERVATIONS = tuple(name for name, spec in PRESETS.items() if not spec.separate)

CHECKPOINT_SECONDS = 30  # between checkpoints, unless a number of steps is configured

METAVARS = {int: "N", float: "X", str: "NAME", bool: None}


@dataclass(frozen=True, kw_only=True)
class EncoderSettings(Settings):
    """A network's observation, and the architecture that turns it into features."""

    observation: str = option("LoRes4E", "observation preset")
    network: str = option(
        "paper", "network architecture", choices=network_names, others="magical.networks"
    )


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(EncoderSettings):
    """The observation and construction of the paper's networks."""

    conventions: str = option(
        APPENDIX,
        "whether images, initialisation and batch norm follow the appendix or the published code "
        "(docs/presets.md)",
        choices=CONVENTIONS,
    )

    @property
    def published(self) -> bool:
        """Whether the published code's conventions apply."""
        return self.conventions == PUBLISHED

    @property
    def pixel_range(self) -> str:
        """The pixel range of the networks' images, a key of `PIXEL_RANGES`."""
        return "symmetric" if self.published else "unit"

    @property
    def action_input(self) -> str:
        """How reward networks take actions as input, a key of `magical_baselines.models.JOINED`."""
        return "embedding" if self.published else "one-hot"

    def augmentations(self, names: str) -> Augmentations:
        """The augmentations with these names, with borders and colours as in the conventions."""
        chosen = parse_augmentations(names)
        if self.published:
            return dataclasses.replace(chosen, borders="repeat", linear_light=False)
        return chosen


@dataclass(frozen=True, kw_only=True)
class DemonstrationSettings(Settings):
    """Which demonstrations to learn from."""

    demos: str = option(MISSING, "folder with a dataset of demonstrations", metavar="FOLDER")
    num_demos: int = option(10, "demonstrations per task, chosen by the seed", POSITIVE)


@dataclass(frozen=True, kw_only=True)
class Config(Settings):
    """Settings common to the runs of all algorithms."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {}}
    # The observations of this package that the algorithm accepts.
    observations: ClassVar[tuple[str, ...]] = IMAGE_OBSERVATIONS
    # Core-seconds per training sample and per action, for algorithms whose cost does not depend on
    # a network of the registry; used only to estimate the time of a run.
    seconds_each: ClassVar[tuple[float, float] | None] = None

    algorithm: str = ""  # its name, an entry point's name, or `module:NAME`
    tasks: tuple[str, ...] = option(MISSING, "one or more tasks to learn", metavar="TASK")
    seed: int = option(
        0, "random seed of demonstrations, initialisation, minibatches and episodes", NOT_NEGATIVE
    )
    device: str = option("auto", "device to compute on", choices=DEVICES)
    # PPO compares ratios with a clip range of 0.01: bfloat16's resolution is nearly as coarse.
    precision: str = option(
        "float32",
        "precision of forward and backward passes; auto: bfloat16 if the processor supports it",
        choices=("auto", "float32", "bfloat16"),
    )
    threads: int = option(
        0,
        "CPU threads; 0: PyTorch's default, or 1 for state vectors in environments",
        (lambda number: 0 <= number <= MAX_THREADS, f"a number from 0 to {MAX_THREADS}"),
    )
    checkpoint_every: int = option(
        0,
        f"batches or updates between checkpoints; 0: at most one every {CHECKPOINT_SECONDS} s",
        NOT_NEGATIVE,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        names = tuple(get_task(name).name for name in self.tasks)
        object.__setattr__(self, "tasks", names)
        if not names or len(set(names)) < len(names):
            raise InvalidConfigError(f"tasks: expected each task once, found {names}")
        if not self.part(EncoderSettings):
            return
        if self.observation not in self.observations and not is_plugin(GROUP, self.observation):
            known = self.observation in (*PRESETS, STATE)
            raise UnknownNameError(
                f"observation {quoted(self.observation)} is "
                f"{f'not taken by {self.algorithm}' if known else 'unknown'}; expected one of: "
                f"{', '.join(self.observations)}"
            )
        if STATE not in self.observations and self.observes_vectors:
            raise InvalidConfigError(
                f"observation: {self.algorithm} learns from images, found a vector"
            )
        if len({self._spec_of(name).network_shape for name in names}) > 1:
            raise InvalidConfigError(
                "observation: state vectors differ between tasks, so one task is expected, found "
                f"{', '.join(names)}; use a pixel observation, or a run for each task"
            )

    def part(self, kind: type[Part]) -> Part | None:
        """The configuration's record of this type; `None` if it has none."""
        values = (getattr(self, field.name) for field in dataclasses.fields(self))
        return next((value for value in values if isinstance(value, kind)), None)

    @property
    def learned_from(self) -> tuple[str, ...]:
        """What the run learns from, in the terms of `magical.runs.sources`."""
        networks = self.part(EncoderSettings)
        demonstrations = (DEMONSTRATIONS,) if self.part(DemonstrationSettings) else ()
        return (*demonstrations, *(sources_of(networks.network) if networks else ()))

    @property
    def training_details(self) -> dict[str, Any]:
        """How a policy is trained, for the `details` of `entry.json` (docs/protocol.md)."""
        demonstrations = self.part(DemonstrationSettings)
        details: dict[str, Any] = {"algorithm": self.algorithm, "training_seed": self.seed}
        if demonstrations:
            details["demonstrations"] = f"{demonstrations.num_demos} of each task"
            details[NUM_DEMOS] = demonstrations.num_demos
        return {**details, LEARNED_FROM: list(dict.fromkeys(self.learned_from))}

    @property
    def num_updates(self) -> int:
        """The number of steps (batches or updates) in a whole run; every subclass defines it."""
        raise NotImplementedError(f"{type(self).__name__} defines no num_updates")

    @property
    def num_threads(self) -> int:
        """CPU threads to train with; 0: PyTorch's default."""
        return self.threads

    @property
    def training_samples(self) -> int:
        """Samples in all forward and backward passes of a whole run, for estimating its time."""
        return 0

    @property
    def environment_steps(self) -> int:
        """Environment steps in a whole run, for estimating its time."""
        return 0

    @property
    def observation(self) -> str:
        """The observation's name."""
        networks = self.part(EncoderSettings)
        assert networks is not None
        return networks.observation

    @property
    def action_space(self) -> ActionSpaceName:
        """The action space of the policy, to which the actions of demonstrations are converted."""
        return "discrete"

    @property
    def observation_spec(self) -> ObservationSpec:
        """The observation's specification; the same for all tasks."""
        return self._spec_of(self.tasks[0])

    def _spec_of(self, task: str) -> ObservationSpec:
        return make_spec(self.observation, get_task(task))

    @property
    def input_shape(self) -> tuple[int, ...]:
        """The shape of one observation as a network input."""
        return self.observation_spec.network_shape

    @property
    def observes_vectors(self) -> bool:
        """Whether observations are state vectors."""
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
        """The configuration of a preset, with some settings, given by option name, replaced.

        Raises:
            UnknownNameError: an unknown preset or setting.
            InvalidConfigError: missing or invalid settings.
        """
        if name not in cls.presets:
            raise UnknownNameError(
                f"preset {name!r} is unknown; {cls.algorithm} has: {', '.join(cls.presets)}"
            )
        return cls._of({**cls.presets[name], **settings})

    @classmethod
    def _of(cls, settings: Mapping[str, Any]) -> Self:
        """The configuration with these settings, by option name, and defaults for all others."""
        fields, parts = by_part(cls, settings)
        if missing := [o.name for o in options(cls) if o.required and o.name not in settings]:
            raise InvalidConfigError(f"expected the setting {missing[0]}, found none")
        hints = type_hints(cls)
        for field in dataclasses.fields(cls):
            if field.name in parts:
                record, given = default_of(field), parts[field.name]
                fields[field.name] = (
                    dataclasses.replace(record, **given) if record else hints[field.name](**given)
                )
        return cls(**fields)

    def replace(self, **settings: Any) -> Self:
        """A copy of the configuration with some settings, given by option name, replaced."""
        return self._of({**self.to_dict(), **settings})

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: the algorithm, and all options by name."""
        plain: dict[str, Any] = {"algorithm": self.algorithm}
        for part, field, _ in all_fields(type(self)):
            value = getattr(getattr(self, part) if part else self, field.name)
            plain[name_of(field)] = list(value) if isinstance(value, tuple) else value
        return plain

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], what: str = "configuration") -> Self:
        """The inverse of `to_dict`.

        Args:
            data: the settings; checked here, as they may come from an untrusted file.
            what: where the data came from, for error messages.

        Raises:
            InvalidConfigError: unknown, missing or invalid settings.
        """
        try:
            return cls._of(data)
        except ValueError as error:
            raise InvalidConfigError(f"{what}: {error}") from error


@dataclass(frozen=True, slots=True)
class Option:
    """A configuration field as a command-line option."""

    name: str
    kind: type
    several: bool
    required: bool
    default: Any
    help: str
    choices: tuple[str, ...]  # from this package
    open: bool  # whether other distributions can add values
    metavar: str | None

    @property
    def flag(self) -> str:
        """The flag, for instance `--num-demos`."""
        return "--" + self.name.replace("_", "-")


def options(kind: type[Config]) -> list[Option]:
    """The options of a configuration class: required ones first, otherwise in field order."""
    found = []
    records = {field.name: default_of(field) for field in dataclasses.fields(kind)}
    for part, field, hint in all_fields(kind):
        record = records[part] if part else None
        default = getattr(record, field.name) if record else field.default
        found.append(_option(kind, field, hint, default))
    return sorted(found, key=lambda option: not option.required)


def _option(kind: type[Config], field: "dataclasses.Field[Any]", hint: Any, default: Any) -> Option:
    several = get_origin(hint) is tuple
    if several or isinstance(hint, types.UnionType):  # tuple[str, ...] or int | None
        hint = next(kind for kind in get_args(hint) if kind not in (Ellipsis, types.NoneType))
    name, choices = name_of(field), field.metadata["choices"]()
    if hint not in METAVARS:
        raise PluginError(
            f"{kind.__name__}, {name}: expected int, float, str or bool, a tuple of one of them, "
            f"or one and None, found {hint}"
        )
    if name == "observation":
        choices = kind.observations
    return Option(
        name,
        hint,
        several,
        default is MISSING,
        None if default is MISSING else default,
        field.metadata["help"],
        choices,
        bool(field.metadata["others"]) or name == "observation",
        None if choices else field.metadata["metavar"] or METAVARS[hint],
    )
