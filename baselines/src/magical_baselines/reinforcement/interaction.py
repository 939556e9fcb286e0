"""Configuration shared by all learners that act in environments."""

from dataclasses import dataclass

from magical.errors import InvalidConfigError
from magical.runs.sources import INTERACTION
from magical.tasks import Horizon
from magical_baselines.config import Config
from magical_baselines.settings import NOT_NEGATIVE, POSITIVE, Settings, option


@dataclass(frozen=True, kw_only=True)
class InteractionSettings(Settings):
    """How many environments a learner acts in, and for how long."""

    total_steps: int = option(1_000_000, "total environment steps", POSITIVE)
    num_envs: int = option(
        32, "N: parallel environments, equally many for each task if they can be", POSITIVE
    )
    num_steps: int = option(8, "T: steps of each environment per update", POSITIVE)
    workers: int | None = option(
        None, "environment processes (default: one per core)", NOT_NEGATIVE
    )
    evaluate_every: int = option(200, "updates between evaluations; 0: never", NOT_NEGATIVE)

    @property
    def steps_per_update(self) -> int:
        """Environment steps per update of the policy."""
        return self.num_envs * self.num_steps

    @property
    def num_updates(self) -> int:
        """Updates of the policy in a whole run."""
        return self.total_steps // self.steps_per_update

    @property
    def env_horizon(self) -> Horizon:
        """The horizon, as passed to the environments."""
        return None


@dataclass(frozen=True, kw_only=True)
class InteractionConfig(Config):
    """A configuration with `InteractionSettings` among its records."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.interaction.num_updates < 1:
            raise InvalidConfigError(
                f"total_steps: expected at least the {self.interaction.steps_per_update} of one "
                f"update (num_envs x num_steps), found {self.interaction.total_steps}"
            )
        if self.interaction.num_envs < len(self.tasks):
            raise InvalidConfigError(
                f"num_envs: expected at least one for each of {len(self.tasks)} tasks, "
                f"found {self.interaction.num_envs}"
            )

    def require_halves(self, option: str, size: int) -> None:
        """Raise `InvalidConfigError` unless a batch has two halves with samples of every task."""
        if size < 2 * len(self.tasks) or size % 2:
            raise InvalidConfigError(
                f"{option}: expected an even number, at least two for each task, found {size}"
            )

    @property
    def interaction(self) -> InteractionSettings:
        """The `InteractionSettings` of the configuration."""
        found = self.part(InteractionSettings)
        assert found is not None
        return found

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        return (*super().learned_from, INTERACTION)

    @property
    def num_updates(self) -> int:
        """Updates of the policy in a whole run."""
        return self.interaction.num_updates

    @property
    def num_threads(self) -> int:
        """See `Config`."""
        return self.threads or int(self.observes_vectors)

    @property
    def environment_steps(self) -> int:
        """Environment steps of all updates."""
        return self.interaction.num_updates * self.interaction.steps_per_update
