"""Rollouts as animations: one episode in each environment, rendered and scored."""

import base64
import io
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation.policy import Policy, checked_actions, is_privileged
from magical.evaluation.rollouts import observation_for
from magical.evaluation.seeds import RolloutRng
from magical.render import Renderer
from magical.scene import State, View
from magical.scene.constants import CONTROL_RATE

SIZE = 160  # pixels across
LAST_FRAME = 1.5  # seconds that an animation shows its last frame


@dataclass(frozen=True, slots=True)
class Clip:
    """One rollout, the allocentric view at every control step, and its final score."""

    env_id: EnvId
    score: float
    frames: NDArray[np.uint8]  # (T + 1, H, W, 3)

    def webp(self, rate: float = CONTROL_RATE) -> bytes:
        """An animated WebP that loops, at `rate` control steps a second."""
        images = [Image.fromarray(frame) for frame in self.frames]
        durations = [round(1000 / rate)] * (len(images) - 1) + [round(1000 * LAST_FRAME)]
        file = io.BytesIO()
        images[0].save(
            file,
            "WEBP",
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            quality=70,
            method=3,
        )
        return file.getvalue()

    def strip(self, count: int = 6) -> NDArray[np.uint8]:
        """`count` frames from first to last side by side, (H, W * count, 3)."""
        indices = np.linspace(0, len(self.frames) - 1, count).round().astype(int)
        return np.concatenate(list(self.frames[indices]), axis=1)


def record_clips(
    policy: Policy, env_ids: Sequence[EnvId], rollout: int = 0, seed: int = 0, size: int = SIZE
) -> list[Clip]:
    """Run the policy once in each environment, all of one task, with evaluation's seeds.

    Raises `PolicyError` where the policy returns something else than actions.
    """
    seeds = [evaluation_seed(rollout, seed)] * len(env_ids)
    observation = observation_for(policy)
    with closing(MagicalVectorEnv(env_ids, workers=0, observation=observation)) as envs:
        rng = RolloutRng(env_ids, seeds)
        observations, info = envs.reset(seed=seeds)
        policy.reset(np.ones(len(env_ids), np.bool_))
        states = envs.states()
        cameras = [Renderer(state.scene, View.ALLO, size) for state in states]
        videos = [[_render(camera, state)] for camera, state in zip(cameras, states, strict=True)]
        for _ in range(states[0].horizon):
            given = states if is_privileged(policy) else observations
            actions = checked_actions(policy.act(given, env_ids, rng), len(env_ids))
            observations, _, _, _, info = envs.step(actions)
            states = envs.states()
            for video, camera, state in zip(videos, cameras, states, strict=True):
                video.append(_render(camera, state))
    return [
        Clip(env_id, float(score), np.array(video))
        for env_id, score, video in zip(env_ids, info["eval_score"], videos, strict=True)
    ]


def _render(camera: Renderer, state: State) -> NDArray[np.uint8]:
    frame = np.empty((camera.size, camera.size, 3), np.uint8)
    camera.render(state.poses.bodies, frame)
    return frame


def data_uri(data: bytes, kind: str) -> str:
    """File contents as a data URI, for instance of kind `image/webp`."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def png(pixels: NDArray[np.uint8]) -> bytes:
    """An (H, W, 3) image as a PNG file's contents."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", optimize=True)
    return file.getvalue()
