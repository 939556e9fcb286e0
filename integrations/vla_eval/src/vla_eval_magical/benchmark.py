"""The benchmark class: a task of vla-eval is one of MAGICAL's tasks in one variant."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, DimSpec
from vla_eval.types import Action, EpisodeResult, Observation, Task

from magical.envs import EnvId, env_spec, parse_env_id
from magical.envs.seeds import evaluation_seed
from magical.evaluation import environments
from magical.observe import PixelSpec
from magical.scene import View

VIEWS = (View.ALLO, View.EGO)
ACTION = DimSpec(
    "action", 3, "drive_turn_grip", (-1, 1), description="1: forward, left, fingers closed"
)
STATE = DimSpec("state", 5, "robot_x_y_angle_left_finger_right_finger")


class MagicalBenchmark(StepBenchmark):  # type: ignore[misc]
    """MAGICAL's tasks, each in the Demo variant and in test variants.

    An observation has the images `allo` and `ego`, the robot's pose and finger angles as `state`,
    and the instruction as `task_description`. An action is drive, turn and grip, each from -1 to
    1. An episode's `score` is MAGICAL's, from 0 to 1, and `success` whether it is above 0.5.

    Args:
        tasks: names, such as `MoveToCorner` (default: all).
        variants: such as `Demo` and `TestColour` (default: all that the tasks have).
        seed: of the evaluation; episodes are those of `magical evaluate` with the same seed.
        size: of the images in pixels.
    """

    _ALL_RECORD_FIELDS = frozenset({"done", "score"})
    # Frames are rendered by the processor.
    render_backends: ClassVar[frozenset[str]] = frozenset({"cpu", "gpu"})

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:
        """Nothing is to be set: there is no graphics library."""
        return {}

    def __init__(
        self,
        tasks: Sequence[str] | None = None,
        variants: Sequence[str] | None = None,
        seed: int = 0,
        size: int = 96,
    ) -> None:
        super().__init__()
        self._ids = environments(tasks, variants)
        self._seed = seed
        self._options: dict[str, Any] = {
            "action_space": "continuous",
            "observation": PixelSpec(tuple((v, 1) for v in VIEWS), separate=True, size=size),
        }
        self._env: Any = None
        self._instruction = ""

    def get_tasks(self) -> list[Task]:
        """Every task in every variant; the variant is the suite."""
        return [{"name": _name(i), "suite": i.variant, "env_id": str(i)} for i in self._ids]

    def reset(self, task: Task) -> Any:
        """Start the episode of the task's `episode_idx`."""
        env_id = parse_env_id(task["env_id"])
        if self._env is None or self._env.unwrapped.env_id != env_id:
            self.cleanup()
            self._env = gymnasium.make(env_spec(env_id), **self._options)
        seed = evaluation_seed(task.get("episode_idx", 0), self._seed)
        observation, info = self._env.reset(seed=seed)
        self._instruction = info["instruction"]
        self._recorder.record_video(observation["allo"])
        return observation

    def step(self, action: Action) -> StepResult:
        """Act for one control step; numbers beyond -1 and 1, which models predict, are clipped."""
        parts = np.clip(np.asarray(action["actions"], np.float32).reshape(-1), -1, 1)
        observation, reward, _, truncated, info = self._env.step(parts)
        self._recorder.record_video(observation["allo"])
        self._recorder.record_step(done=truncated, score=info["eval_score"])
        return StepResult(observation, float(reward), truncated, info)

    def make_obs(self, raw_obs: Any, task: Task) -> Observation:
        """Images, the robot's state and the instruction."""
        return {
            "images": {view: np.asarray(raw_obs[view]) for view in VIEWS},
            "state": self._state(),
            "task_description": self._instruction,
        }

    def _state(self) -> NDArray[np.float32]:
        poses = self._env.unwrapped.state().poses
        x, y, angle = poses.robot
        return np.array([x, y, angle, *(np.asarray(poses.finger_angles) - angle)], np.float32)

    def get_step_result(self, step_result: StepResult) -> EpisodeResult:
        """Success and score of the episode."""
        info = step_result.info
        return {"success": bool(info["is_success"]), "score": float(info["eval_score"])}

    def get_metric_keys(self) -> dict[str, str]:
        """Both are averaged."""
        return {"success": "mean", "score": "mean"}

    def get_metadata(self) -> dict[str, Any]:
        """The longest horizon of the tasks; episodes end by themselves."""
        return {"max_steps": max(i.task_spec.horizon for i in self._ids), "action_dim": ACTION.dims}

    def get_hold_action(self, last_action: Action | None) -> Action:
        """Stand still, with the fingers as they were."""
        grip = -1.0 if last_action is None else np.ravel(last_action["actions"])[2]
        return {"actions": np.array([0.0, 0.0, grip], np.float32)}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Drive, turn and grip."""
        return {"action": ACTION}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Two images, the robot's state and the instruction."""
        return {**dict.fromkeys(VIEWS, IMAGE_RGB), "state": STATE, "language": LANGUAGE}

    def cleanup(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env.close()
            self._env = None


def _name(env_id: EnvId) -> str:
    return f"{env_id.task}-{env_id.variant}"
