"""Whole episodes of a policy, to look at."""

import numpy as np

from magical.demos.generate import demonstrate
from magical.demos.record import recorded_trajectory
from magical.demos.store.trajectory import Trajectory
from magical.envs.env import MagicalEnv
from magical.envs.ids import EnvId
from magical.evaluation.rollouts import observation_for
from magical.evaluation.seeds import RolloutRng
from magical.web.library.policies import Policies, act_on_one_thread


def roll_out(policies: Policies, number: int, env_id: EnvId, seed: int) -> Trajectory:
    """One episode of a policy, from the scene of `reset(seed=seed)`.

    Actions are sampled as in an evaluation. The demonstrator is the policy's name.

    Raises:
        NotFoundError: there is no policy of that number.
        MagicalError: it cannot be loaded, or cannot act in the environment.
    """
    entry = policies.find(number)
    entry.check(env_id)
    if entry.folder is None:
        return demonstrate(env_id, seed)
    policy = policies.load(number)
    env = MagicalEnv(env_id.task, env_id.variant, observation=observation_for(policy))
    observation = env.reset(seed=seed)[0]
    policy.reset(np.ones(1, np.bool_))
    rng = RolloutRng([env_id], [seed])
    poses = [env.state().poses.bodies.copy()]
    truncated = False
    while not truncated:
        action = act_on_one_thread(policy, as_batch(observation), [env_id], rng)
        observation, _, _, truncated, _ = env.step(action)
        poses.append(env.state().poses.bodies.copy())
    remarks = {"recorder": "magical play", "policy": entry.name}
    return recorded_trajectory(env, poses, seed=seed, demonstrator=entry.name, metadata=remarks)


def as_batch(observation: object) -> object:
    """One observation, an array or a dict of arrays, as a batch of one."""
    if isinstance(observation, dict):
        return {name: np.asarray(part)[None] for name, part in observation.items()}
    return np.asarray(observation)[None]
