"""Recording the episodes of an environment, whatever chooses the actions."""

import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from magical import __version__
from magical.demos.dataset import DatasetWriter
from magical.demos.trajectory import Trajectory
from magical.envs.env import MagicalEnv
from magical.errors import TrajectoryError
from magical.scene import Scene


class RecordTrajectories(gym.Wrapper[Any, Any, Any, Any]):
    """A wrapper that stores every finished episode in a dataset, which is created if needed.

    It works with any policy or `gymnasium.utils.play`, and with other wrappers inside or around it.
    An episode that is reset before its end is not stored.

    `demonstrator` is the name of the person or policy that chooses the actions.

    Raises:
        TrajectoryError: the environment is not one of magical's, or `set_state` was called.
        DatasetError: the dataset cannot be written.
    """

    def __init__(self, env: gym.Env[Any, Any], dataset: Path | str, *, demonstrator: str) -> None:
        super().__init__(env)
        if not isinstance(env.unwrapped, MagicalEnv):
            raise TrajectoryError(f"expected one of magical's environments, found {env.unwrapped}")
        self._inner = env.unwrapped
        self._by: dict[str, Any] = {"demonstrator": demonstrator}
        self._writer = DatasetWriter(dataset)
        self._bodies: list[NDArray[np.float64]] = []
        self._scene: Scene | None = None  # of the episode that is recorded

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and start recording an episode."""
        result = super().reset(seed=seed, options=options)
        self._start(seed)
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment; at the end of the episode, store it."""
        result = super().step(action)
        state = self._inner.state()
        if state.step == 0:  # a wrapper inside this one has reset the environment
            self._start(seed=None)
            return result
        if state.scene is not self._scene:  # `set_state` makes a new one, even for the same episode
            raise TrajectoryError("the episode was not recorded from its start; reset() first")
        self._bodies.append(state.bodies)
        if result[2] or result[3]:
            self._writer.append(recorded_trajectory(self._inner, self._bodies, **self._by))
            self._scene = None
        return result

    def _start(self, seed: int | None) -> None:
        state = self._inner.state()
        self._scene, self._bodies, self._by["seed"] = state.scene, [state.bodies], seed


def recorded_trajectory(
    env: MagicalEnv,
    bodies: Sequence[NDArray[np.float64]],
    *,
    seed: int | None,
    demonstrator: str,
    metadata: Mapping[str, Any] | None = None,
) -> Trajectory:
    """The trajectory of an environment's current episode, scored at its last poses.

    `bodies` are (5 + blocks, 6) each, after `reset` and after every step since. `metadata` is
    stored together with the date and versions.
    """
    return Trajectory.from_bodies(
        env.env_id,
        env.simulation.scene,
        env.action_spec.convert(np.array(env.actions)),
        np.stack(bodies),
        dynamics=env.simulation.dynamics,
        seed=seed,
        demonstrator=demonstrator,
        metadata={**provenance(), **(metadata or {})},
    )


def provenance() -> dict[str, Any]:
    """Date, versions and platform of a recording made now, as plain data."""
    libraries = {library: version(library) for library in ("numpy", "pymunk", "gymnasium")}
    return {
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"magical": __version__, "python": platform.python_version(), **libraries},
        "platform": platform.platform(terse=True),
    }
