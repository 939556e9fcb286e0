"""Whole episodes of the scripted experts."""

from dataclasses import dataclass

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from magical.errors import InvalidTaskError
from magical.experts.expert import EpisodeExpert, expert_for, strategy_seed
from magical.experts.goals import get_planner
from magical.experts.noise import RandomActions
from magical.physics import Simulation
from magical.scene import POINTS, Dynamics, Poses, Scene, State
from magical.tasks import get_task
from magical.tasks.registry import defining_modules


@dataclass(frozen=True, slots=True)
class ExpertEpisode:
    """One episode: its initial scene and dynamics, the actions, and all poses and velocities."""

    scene: Scene
    dynamics: Dynamics
    actions: NDArray[np.int64]  # (T,), executed
    expert_actions: NDArray[np.int64]  # (T,), the expert's; the same unless perturbed
    bodies: NDArray[np.float64]  # (T + 1, bodies, 6): poses and velocities, rows as in `Poses`
    score: float  # of the last poses, by the appendix's rule

    @property
    def poses(self) -> NDArray[np.float64]:
        """All poses, (T + 1, bodies, 3)."""
        return self.bodies[:, :, :3]


def rollout(
    task: str, variant: str = "Demo", seed: int | None = None, *, perturb: float = 0.0
) -> ExpertEpisode:
    """Roll out the expert in the episode that the environment's `reset(seed=seed)` starts.

    Args:
        task: the task's name.
        variant: the variant's name, such as TestLayout.
        seed: seed of the scene, the dynamics, the strategy and the random actions; None: random.
        perturb: share of steps, from 0 to 1, with a random action in place of the expert's.

    Raises:
        InvalidConfigError: the share is not between 0 and 1.
        UnknownNameError: the task or variant does not exist.
        NoExpertError: the task has no expert.
        InvalidSceneError: the sampled scene does not fit the task.
    """
    spec, rng = get_task(task), np_random(seed)[0]
    scene, dynamics = spec.sample(variant, rng)
    spec.validate(scene)
    expert = EpisodeExpert(expert_for(task, seed=strategy_seed(variant, seed)))
    random_actions = RandomActions(perturb, rng.spawn(1)[0])
    simulation = Simulation(scene, dynamics)
    chosen, tables = [], [simulation.read()]
    for step in range(spec.horizon):
        poses, velocities = Poses(tables[-1][:, :3]), tables[-1][:, 3:]
        expert_action = expert.act(State(scene, poses, velocities, step, spec.horizon))
        action = random_actions.execute(expert_action)
        expert.note_executed(action)
        chosen.append((action, expert_action))
        tables.append(simulation.step(POINTS[action]))
    actions, expert_actions = np.array(chosen).T
    score = spec.score(scene, Poses(tables[-1][:, :3]))
    return ExpertEpisode(scene, dynamics, actions, expert_actions, np.stack(tables), score)


def modules_of(task: str) -> list[str]:
    """The modules that a new process must import to have a task and its expert.

    Raises:
        InvalidTaskError: the task, or its expert, is not in an importable module.
        NoExpertError: the task has no expert.
    """
    modules, plan_fn = defining_modules([get_task(task)]), get_planner(task).plan_fn
    module = getattr(plan_fn, "func", plan_fn).__module__  # for a partial, its function's
    if module == "__main__":
        raise InvalidTaskError(
            f"expert of {task}: other processes never import the main script, which holds this "
            "one; put it into a module that registers it, or use workers=1"
        )
    return sorted({*modules, module})
