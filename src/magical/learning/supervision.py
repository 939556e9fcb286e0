"""Episodes in which a policy acts and scripted experts label every state with their action."""

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

LABELS = "expert_actions"  # metadata: the expert's action in each state, (T,)


class LabelledEpisodes:
    """Environments, one per episode, that policies and experts act in.

    Each episode has its own expert, with a strategy sampled as for demonstrations. The expert
    observes the episode from the start, whether or not its actions are taken.
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
        self, policy: Policy, beta: float, rng: np.random.Generator, **remarks: Any
    ) -> list[Trajectory]:
        """Collect one episode in every environment, with the experts' labels in its metadata.

        Args:
            policy: acts, except where the expert does.
            beta: the probability, at each step, that the expert's action is taken.
            rng: also determines the scenes, which are never those of evaluation.
            **remarks: added to the metadata.

        Raises:
            NoExpertError: a task has no expert.
        """
        envs, count = self.envs, self.envs.num_envs
        seeds = sample_training_seeds(rng, count)
        observations, _ = envs.reset(seed=seeds)
        policy.reset(np.ones(count, np.bool_))
        starts = [(state.scene, self._dynamics(row)) for row, state in enumerate(envs.states())]
        experts = [
            _EpisodeExpert(env_id, seed) for env_id, seed in zip(envs.env_ids, seeds, strict=True)
        ]
        poses, taken, labels = [envs.bodies[0][:, :, :3].copy()], [], []
        active = np.ones(count, np.bool_)
        while active.any():
            expert_actions = [
                expert.act(state) if is_active else 0
                for expert, state, is_active in zip(experts, envs.states(), active, strict=True)
            ]
            policy_actions = np.asarray(policy.act(observations, envs.env_ids, rng))
            is_experts = rng.random(count) < beta
            actions = np.where(is_experts, expert_actions, policy_actions)  # (N,)
            observations, _, _, truncated, _ = envs.step(actions, active)
            active &= ~truncated
            poses.append(envs.bodies[0][:, :, :3].copy())
            taken.append(actions)
            labels.append(expert_actions)
        remarks = {"expert_share": beta, **remarks, **provenance()}
        return self._trajectories(
            starts, seeds, np.array(taken), np.array(labels), np.stack(poses), remarks
        )

    def _dynamics(self, row: int) -> Dynamics:
        return Dynamics.from_dict(self.envs.get_state(row)["dynamics"])

    def _trajectories(
        self,
        starts: Sequence[tuple[Scene, Dynamics]],
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
            for row, ((scene, dynamics), steps) in enumerate(zip(starts, lengths, strict=True))
        ]


class _EpisodeExpert:
    """An expert and its memory of one episode."""

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self._expert = expert_for(env_id.task, seed=seed)
        self._memory: Memory | None = None

    def act(self, state: State) -> int:
        action, self._memory = self._expert.act(state, self._memory)
        return action


def relabel(trajectory: Trajectory) -> Trajectory:
    """Replace the actions that were taken by the expert's labels.

    Raises:
        DemonstrationsError: there are no labels, or they do not fit the trajectory.
    """
    labels = np.asarray(trajectory.metadata.get(LABELS, []))
    good = labels.shape == trajectory.actions.shape and labels.dtype.kind == "i"
    if not good or labels.min() < 0 or labels.max() >= NUM_ACTIONS:
        raise DemonstrationsError(
            f"{trajectory.env_id}: expected {len(trajectory)} actions in the metadata "
            f"{LABELS!r}, found {str(trajectory.metadata.get(LABELS))[:60]}"
        )
    return replace(trajectory, actions=labels)
