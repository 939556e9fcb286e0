"""What LeRobot's policies observe, as an observation of the package."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from magical.errors import ObservationError
from magical.observe import PixelSpec
from magical.observe.arrays import ArrayFields, empty
from magical.observe.spec import EpisodeSource
from magical.scene.poses import FINGERS, ROBOT
from magical.scene.scene import Scene
from magical.scene.vocabulary import View

VIEWS = (View.ALLO, View.EGO)
ROBOT_STATE = "agent_pos"  # the key
STATE_SIZE = 5  # x, y, angle of the robot, angles of the left and the right finger
NAME = "lerobot"  # the entry point of `VIEWS_AND_ROBOT`


@dataclass(frozen=True, slots=True)
class ViewsAndRobot:
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
    def fields(self) -> ArrayFields:
        """See `ObservationSpec`."""
        return {**self.pixels.fields, ROBOT_STATE: ((STATE_SIZE,), np.float32)}

    @property
    def space(self) -> spaces.Dict:
        """See `ObservationSpec`."""
        state = spaces.Box(-np.inf, np.inf, (STATE_SIZE,), np.float32)
        return spaces.Dict({**self.pixels.space, ROBOT_STATE: state})  # type: ignore[dict-item]

    @property
    def frames(self) -> int:
        """See `ObservationSpec`."""
        return 1

    @property
    def num_images(self) -> int:
        """See `ObservationSpec`."""
        return len(VIEWS)

    @property
    def network_shape(self) -> tuple[int, ...]:
        """See `ObservationSpec`: raises `ObservationError`, as for every dict."""
        return self.pixels.network_shape

    @property
    def components(self) -> Any:
        """See `ObservationSpec`: of the views."""
        return self.pixels.components

    def network_input(self, observations: Any) -> NDArray[Any]:
        """See `ObservationSpec`: raises `ObservationError`, as for every dict."""
        return self.pixels.network_input(observations)

    def picture(self, observation: Any) -> NDArray[np.uint8]:
        """See `ObservationSpec`: both views side by side."""
        return self.pixels.picture(observation)

    def observer(self, out: Any = None) -> "_Observer":
        """See `ObservationSpec`."""
        return _Observer(self, empty(self.fields) if out is None else out)

    def read(self, source: EpisodeSource, times: ArrayLike, out: Any = None) -> Any:
        """See `ObservationSpec`."""
        steps = np.asarray(times, np.intp)
        out = empty(self.fields, steps.shape) if out is None else out
        self.pixels.read(source, steps, {view: out[view] for view in VIEWS})
        bodies = source.body_states()[steps]
        out[ROBOT_STATE][...] = robot_states(bodies)
        return out

    def to_dict(self) -> str:
        """See `ObservationSpec`: the entry point's name; other sizes have none."""
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
