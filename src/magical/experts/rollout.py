"""Whole episodes of the scripted experts."""

from dataclasses import dataclass

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from magical.envs.vector.workers import defining_modules
from magical.errors import NoSolutionError
from magical.experts.expert import expert_for
from magical.experts.goals import get_goals
from magical.experts.memory import Memory
from magical.physics import Simulation
from magical.scene import NUM_ACTIONS, Dynamics, Poses, Scene, State
from magical.tasks import get_task


@dataclass(frozen=True, slots=True)
class Rollout:
    """One episode: its initial scene and dynamics, the actions, and all poses."""

    scene: Scene
    dynamics: Dynamics
    actions: NDArray[np.int64]  # (T,)
    poses: NDArray[np.float64]  # (T + 1, bodies, 3), rows as in `Poses`
    score: float  # of the last poses, by the appendix


def check_solvable(task: str, scene: Scene) -> None:
    """Check that some sequence of actions solves the task in this scene.

    Raises:
        NoExpertError: the task has no expert.
        NoSolutionError: there is none; says what the scene lacks.
    """
    if reason := get_goals(task).unsolvable_fn(scene):
        raise NoSolutionError(f"{task}: {reason}")


def rollout(
    task: str,
    variant: str = "Demo",
    seed: int | None = None,
    *,
    skill: float = 1.0,
    random_steps: int = 0,
    strategy_seed: int | None = None,
) -> Rollout:
    """Roll out the expert in the episode that the environment's `reset(seed=seed)` starts.

    Args:
        task: The task's name.
        variant: The variant's name, such as TestLayout.
        seed: Of the scene, the dynamics and the random steps; None: a random one.
        skill: From 0 to 1, as in `expert_for`.
        random_steps: Control steps in which a random policy acts before the expert takes over.
        strategy_seed: Of the expert's strategy; None: `seed`.

    Raises:
        UnknownNameError: the task or variant does not exist.
        NoExpertError: the task has no expert.
        NoSolutionError: the scene cannot be solved.
    """
    spec = get_task(task)
    rng = np_random(seed)[0]
    scene, dynamics = spec.sample(variant, rng)
    check_solvable(task, scene)
    expert = expert_for(task, seed=seed if strategy_seed is None else strategy_seed, skill=skill)
    simulation = Simulation(scene, dynamics)
    memory: Memory | None = None
    actions: list[int] = []
    tables = [simulation.read().copy()]
    for step in range(spec.horizon):
        if step < random_steps:
            action = int(rng.integers(NUM_ACTIONS))
        else:
            table = tables[-1]
            state = State(scene, Poses(table[:, :3]), table[:, 3:], step, spec.horizon)
            action, memory = expert.act(state, memory)
        simulation.step(action)
        actions.append(action)
        tables.append(simulation.read().copy())
    poses = np.stack(tables)[:, :, :3]
    score = spec.score(scene, Poses(poses[-1]))
    return Rollout(scene, dynamics, np.array(actions), poses, score)


def modules_of(task: str) -> list[str]:
    """The modules from which a new process learns of a task and of its expert.

    Raises:
        InvalidTaskError: the task is from outside the package and in no importable module.
        NoExpertError: the task has no expert.
    """
    return sorted({*defining_modules([get_task(task)]), get_goals(task).plan_fn.__module__})
