"""Episodes in which a policy acts and scripted experts label every state with their action."""

from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from magical.demos import Trajectory
from magical.demos.store.provenance import provenance
from magical.envs import EnvId
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation.policy import Policy
from magical.experts import EpisodeExpert, expert_for
from magical.scene import Dynamics, Scene


class LabelledEpisodes:
    """Environments, one per episode, that policies and experts act in.

    Each episode has its own expert, with a strategy sampled as for demonstrations. The expert
    observes the episode from the start; where the policy does something else, it takes over from
    the next state.
    """

    def __init__(self, env_ids: Sequence[EnvId], observation: str, workers: int | None) -> None:
        self.envs = MagicalVectorEnv(
            env_ids, workers=workers, observation=observation, autoreset_mode="Disabled", copy=False
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
        """Collect one episode in every environment, labelled by the experts.

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
            EpisodeExpert(expert_for(env_id.task, seed=seed))
            for env_id, seed in zip(envs.env_ids, seeds, strict=True)
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
            for expert, action in zip(experts, actions.tolist(), strict=True):
                expert.note_executed(action)
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
                expert_actions=labels[:steps, row],
                metadata=remarks,
            )
            for row, ((scene, dynamics), steps) in enumerate(zip(starts, lengths, strict=True))
        ]
