"""What LeRobot's policies observe, as an observation of the package."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import create_empty_array
from numpy.typing import ArrayLike, NDArray

from magical.errors import ObservationError
from magical.observe import EpisodeSource, ObservationSpec, PixelSpec, select
from magical.scene import FINGERS, ROBOT, Scene, View

VIEWS = (View.ALLO, View.EGO)
ROBOT_STATE = "agent_pos"  # the key
STATE_SIZE = 5  # x, y, angle of the robot, angles of the left and the right finger
NAME = "lerobot"  # the entry point of `VIEWS_AND_ROBOT`


@dataclass(frozen=True)
class ViewsAndRobot(ObservationSpec):
    """The newest frame of both views, (size, size, 3) uint8, and `agent_pos`, (5,) float32.

    `agent_pos` is the robot's x, y and angle, and the angles of its fingers relative to it, as
    `observation.state` of a dataset that `lerobot_env_magical.export` writes.
    """

    size: int = 96

    @property
    def pixels(self) -> PixelSpec:
        """The part that is rendered."""
        return PixelSpec(tuple((view, 1) for view in VIEWS), separate=True, size=self.size)

    @property
    def space(self) -> spaces.Dict:
        state = spaces.Box(-np.inf, np.inf, (STATE_SIZE,), np.float32)
        return spaces.Dict({**self.pixels.space, ROBOT_STATE: state})  # type: ignore[dict-item]

    @property
    def num_images(self) -> int:
        return len(VIEWS)

    @property
    def network_shape(self) -> tuple[int, ...]:
        return self.pixels.network_shape  # raises `ObservationError`, as for every dict

    @property
    def components(self) -> Any:
        return self.pixels.components

    def network_input(self, observations: Any) -> NDArray[Any]:
        return self.pixels.network_input(observations)  # raises, like `network_shape`

    def observer(self, out: Any = None) -> "_Observer":
        return _Observer(self, select(create_empty_array(self.space), 0) if out is None else out)

    def read(self, source: EpisodeSource, times: ArrayLike) -> Any:
        steps = np.asarray(times, np.intp)
        states = robot_states(source.body_states()[steps]).astype(np.float32)
        return {**self.pixels.read(source, steps), ROBOT_STATE: states}

    def to_dict(self) -> str:
        """The entry point's name; other sizes have none."""
        if self != VIEWS_AND_ROBOT:
            raise ObservationError(
                f"size: expected {VIEWS_AND_ROBOT.size}, the only one that entries have a "
                f"name for, found {self.size}"
            )
        return NAME


class _Observer:
    def __init__(self, spec: ViewsAndRobot, out: Any) -> None:
        self.out = out
        self._pixels = spec.pixels.observer({view: out[view] for view in VIEWS})

    def start(self, scene: Scene, bodies: NDArray[np.float64]) -> None:
        """Start an episode."""
        self._pixels.start(scene, bodies[:, :3])
        self.out[ROBOT_STATE][:] = robot_states(bodies)

    def update(self, bodies: NDArray[np.float64]) -> None:
        """Observe the next step."""
        self._pixels.update(bodies[:, :3])
        self.out[ROBOT_STATE][:] = robot_states(bodies)


def robot_states(bodies: NDArray[np.float64]) -> NDArray[np.float64]:
    """The robot's pose, and its fingers' angles relative to it (..., 5), of bodies (..., N, 6)."""
    robot = bodies[..., ROBOT, :3]
    return np.concatenate([robot, bodies[..., FINGERS, 2] - robot[..., 2:]], axis=-1)


VIEWS_AND_ROBOT = ViewsAndRobot()
