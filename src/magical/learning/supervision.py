"""Episodes in which the learner acts and scripted experts say what they would have done."""

from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from magical.demos import Trajectory
from magical.demos.store.provenance import provenance
from magical.envs import EnvId
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.errors import DemonstrationsError
from magical.evaluation.policy import Policy
from magical.experts import Memory, expert_for
from magical.scene import NUM_ACTIONS, Dynamics, Scene, State

LABELS = "expert_actions"  # metadata: what the expert would have done at each step, (T,)


class Supervision:
    """Worlds, one an episode, that end when all episodes have.

    Each episode is watched by an expert with a strategy of its own, drawn as for demonstrations.
    It follows the episode from its start, with its memory, whoever acts.
    """

    def __init__(self, env_ids: Sequence[EnvId], observation: str, workers: int | None) -> None:
        self.envs = MagicalVectorEnv(
            env_ids,
            workers=workers,
            observation=observation,
            autoreset_mode="Disabled",
            copy=False,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.envs.close()

    def collect(
        self, policy: Policy, expert_share: float, rng: np.random.Generator, **remarks: Any
    ) -> list[Trajectory]:
        """One episode of every world; the experts' labels are in its metadata.

        At each step the expert's action is taken with probability `expert_share`, else the
        policy's. `remarks` go into the metadata too. Scenes are never those of evaluation.

        Raises:
            NoExpertError: a task has no expert.
        """
        envs, count = self.envs, self.envs.num_envs
        seeds = sample_training_seeds(rng, count)
        observations, _ = envs.reset(seed=seeds)
        policy.reset(np.ones(count, np.bool_))
        begun = [(state.scene, self._dynamics(row)) for row, state in enumerate(envs.states())]
        watchers = [
            _Watcher(env_id, seed) for env_id, seed in zip(envs.env_ids, seeds, strict=True)
        ]
        poses, taken, labels = [envs.bodies[0][:, :, :3].copy()], [], []
        active = np.ones(count, np.bool_)
        while active.any():
            wanted = [
                watcher.act(state) if acts else 0
                for watcher, state, acts in zip(watchers, envs.states(), active, strict=True)
            ]
            own = np.asarray(policy.act(observations, envs.env_ids, rng))
            actions = np.where(rng.random(count) < expert_share, wanted, own)  # (N,)
            observations, _, _, truncated, _ = envs.step(actions, active)
            active &= ~truncated
            poses.append(envs.bodies[0][:, :, :3].copy())
            taken.append(actions)
            labels.append(wanted)
        remarks = {"expert_share": expert_share, **remarks, **provenance()}
        return self._trajectories(
            begun, seeds, np.array(taken), np.array(labels), np.stack(poses), remarks
        )

    def _dynamics(self, row: int) -> Dynamics:
        return Dynamics.from_dict(self.envs.get_state(row)["dynamics"])

    def _trajectories(
        self,
        begun: Sequence[tuple[Scene, Dynamics]],
        seeds: Sequence[int],
        actions: NDArray[np.int64],  # (T, N)
        labels: NDArray[np.int64],  # (T, N)
        poses: NDArray[np.float64],  # (T + 1, N, max bodies, 3)
        remarks: dict[str, Any],
    ) -> list[Trajectory]:
        bodies = self.envs.bodies[1].tolist()
        lengths = [state.horizon for state in self.envs.states()]
        return [
            Trajectory.from_poses(
                self.envs.env_ids[row],
                scene,
                actions[:steps, row],
                poses[: steps + 1, row, : bodies[row]],
                dynamics=dynamics,
                seed=seeds[row],
                demonstrator="dagger",
                metadata={LABELS: labels[:steps, row].tolist(), **remarks},
            )
            for row, ((scene, dynamics), steps) in enumerate(zip(begun, lengths, strict=True))
        ]


class _Watcher:
    """An expert and what it remembers of its episode."""

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self._expert = expert_for(env_id.task, seed=seed)
        self._memory: Memory | None = None

    def act(self, state: State) -> int:
        action, self._memory = self._expert.act(state, self._memory)
        return action


def relabelled(trajectory: Trajectory) -> Trajectory:
    """The same moments with the expert's actions in place of those that were taken.

    Raises:
        DemonstrationsError: it has no labels, or none that fit.
    """
    labels = np.asarray(trajectory.metadata.get(LABELS, []))
    good = labels.shape == trajectory.actions.shape and labels.dtype.kind == "i"
    if not good or labels.min() < 0 or labels.max() >= NUM_ACTIONS:
        raise DemonstrationsError(
            f"{trajectory.env_id}: expected {len(trajectory)} actions in the metadata "
            f"{LABELS!r}, found {str(trajectory.metadata.get(LABELS))[:60]}"
        )
    return replace(trajectory, actions=labels)
