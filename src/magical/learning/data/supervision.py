"""Episodes in which a policy acts and scripted experts label every state with their action."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos import Trajectory
from magical.demos.record import provenance
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation.policy import Policy
from magical.experts import EpisodeExpert, expert_for
from magical.scene import Dynamics


def collect_labelled(
    envs: MagicalVectorEnv, policy: Policy, beta: float, rng: np.random.Generator, **remarks: Any
) -> list[Trajectory]:
    """Collect one episode in every environment, labelled by an expert of its own.

    The expert observes the episode from the start; where the policy does something else, it takes
    over from the next state.

    Args:
        envs: one for each episode, without automatic resets.
        policy: acts, except where the expert does.
        beta: the probability, at each step, that the expert's action is taken.
        rng: also determines the scenes, which are never those of evaluation.
        **remarks: added to the metadata.

    Raises:
        NoExpertError: a task has no expert.
    """
    count = envs.num_envs
    seeds = sample_training_seeds(rng, count)
    observations, _ = envs.reset(seed=seeds)
    policy.reset(np.ones(count, np.bool_))
    experts = [
        EpisodeExpert(expert_for(env_id.task, seed=seed))
        for env_id, seed in zip(envs.env_ids, seeds, strict=True)
    ]
    taken, labels, poses = _act(envs, observations, policy, experts, beta, rng)
    metadata = {"expert_share": beta, **remarks, **provenance()}
    bodies = envs.bodies[1].tolist()
    return [
        Trajectory.from_poses(
            envs.env_ids[row],
            state.scene,
            taken[: state.horizon, row],
            poses[: state.horizon + 1, row, : bodies[row]],
            dynamics=Dynamics.from_dict(envs.get_state(row)["dynamics"]),
            seed=seeds[row],
            demonstrator="dagger",
            expert_actions=labels[: state.horizon, row],
            metadata=metadata,
        )
        for row, state in enumerate(envs.states())
    ]


def _act(
    envs: MagicalVectorEnv,
    observations: Any,
    policy: Policy,
    experts: Sequence[EpisodeExpert],
    beta: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Actions taken (T, N), the experts' (T, N), and poses (T + 1, N, max bodies, 3)."""
    poses, taken, labels = [envs.bodies[0][:, :, :3].copy()], [], []
    active = np.ones(envs.num_envs, np.bool_)
    while active.any():
        expert_actions = [
            expert.act(state) if is_active else 0
            for expert, state, is_active in zip(experts, envs.states(), active, strict=True)
        ]
        policy_actions = np.asarray(policy.act(observations, envs.env_ids, rng))
        is_experts = rng.random(envs.num_envs) < beta
        actions = np.where(is_experts, expert_actions, policy_actions)  # (N,)
        for expert, action in zip(experts, actions.tolist(), strict=True):
            expert.note_executed(action)
        observations, _, _, truncated, _ = envs.step(actions, active)
        active &= ~truncated
        poses.append(envs.bodies[0][:, :, :3].copy())
        taken.append(actions)
        labels.append(expert_actions)
    return np.array(taken), np.array(labels), np.stack(poses)
