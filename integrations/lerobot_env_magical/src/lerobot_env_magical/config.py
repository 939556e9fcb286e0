"""LeRobot's configuration of the environment: what `--env.type=magical --env....` sets."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

from lerobot_env_magical.env import GYM_ID
from lerobot_env_magical.observation import STATE_SIZE, VIEWS
from magical.scene.constants import CONTROL_RATE


@EnvConfig.register_subclass("magical")
@dataclass
class MagicalEnvConfig(EnvConfig):  # type: ignore[misc]
    """A task in a variant.

    Attributes:
        task: such as `MoveToCorner-TestColour-v0`.
        size: of the images in pixels.
    """

    task: str | None = "MoveToCorner-Demo-v0"
    fps: int = int(CONTROL_RATE)
    size: int = 96
    features: dict[str, Any] = field(default_factory=dict)
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            **{f"pixels/{view}": f"{OBS_IMAGES}.{view}" for view in VIEWS},
        }
    )

    def __post_init__(self) -> None:
        image = PolicyFeature(type=FeatureType.VISUAL, shape=(self.size, self.size, 3))
        self.features = {
            ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(3,)),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(STATE_SIZE,)),
            **{f"pixels/{view}": image for view in VIEWS},
        }

    @property
    def package_name(self) -> str:
        """What LeRobot imports where the id is not registered."""
        return "lerobot_env_magical"

    @property
    def gym_id(self) -> str:
        """The id of the environment with LeRobot's keys; the task is an argument of it."""
        return GYM_ID

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `LeRobotMagicalEnv`."""
        return {"env_id": self.task, "size": self.size}
