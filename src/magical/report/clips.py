"""Rollouts as pictures: one episode in each environment, drawn and scored."""

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
from magical.evaluation.rollouts import shown_to
from magical.evaluation.seeds import RolloutRng
from magical.render import Renderer
from magical.scene import State, View
from magical.scene.constants import CONTROL_RATE

SIZE = 160  # pixels across
LAST_FRAME = 1.5  # seconds that an animation rests at its end


@dataclass(frozen=True, slots=True)
class Clip:
    """One rollout, the allocentric view at every control step, and its final score."""

    env_id: EnvId
    score: float
    frames: NDArray[np.uint8]  # (T + 1, H, W, 3)

    def webp(self, rate: float = CONTROL_RATE) -> bytes:
        """An animated WebP that repeats, `rate` control steps a second."""
        pictures = [Image.fromarray(frame) for frame in self.frames]
        durations = [round(1000 / rate)] * (len(pictures) - 1) + [round(1000 * LAST_FRAME)]
        file = io.BytesIO()
        pictures[0].save(
            file,
            "WEBP",
            save_all=True,
            append_images=pictures[1:],
            duration=durations,
            loop=0,
            quality=70,
            method=3,
        )
        return file.getvalue()

    def strip(self, count: int = 6) -> NDArray[np.uint8]:
        """`count` moments from first to last side by side, (H, W * count, 3)."""
        moments = np.linspace(0, len(self.frames) - 1, count).round().astype(int)
        return np.concatenate(list(self.frames[moments]), axis=1)


def record_clips(
    policy: Policy, env_ids: Sequence[EnvId], rollout: int = 0, seed: int = 0, size: int = SIZE
) -> list[Clip]:
    """Roll the policy out once in each environment, all of one task, with evaluation's seeds.

    Raises `PolicyError` where the policy returns something else than actions.
    """
    seeds = [evaluation_seed(rollout, seed)] * len(env_ids)
    observation = shown_to(policy)
    with closing(MagicalVectorEnv(env_ids, workers=0, observation=observation)) as envs:
        rng = RolloutRng(env_ids, seeds)
        observations, info = envs.reset(seed=seeds)
        policy.reset(np.ones(len(env_ids), np.bool_))
        states = envs.states()
        cameras = [Renderer(state.scene, View.ALLO, size) for state in states]
        films = [[_photo(camera, state)] for camera, state in zip(cameras, states, strict=True)]
        for _ in range(states[0].horizon):
            shown = states if is_privileged(policy) else observations
            actions = checked_actions(policy.act(shown, env_ids, rng), len(env_ids))
            observations, _, _, _, info = envs.step(actions)
            states = envs.states()
            for film, camera, state in zip(films, cameras, states, strict=True):
                film.append(_photo(camera, state))
    return [
        Clip(env_id, float(score), np.array(film))
        for env_id, score, film in zip(env_ids, info["eval_score"], films, strict=True)
    ]


def _photo(camera: Renderer, state: State) -> NDArray[np.uint8]:
    frame = np.empty((camera.size, camera.size, 3), np.uint8)
    camera.render(state.poses.bodies, frame)
    return frame


def data_uri(data: bytes, kind: str) -> str:
    """File contents as an address that a page can hold, for instance of kind `image/webp`."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def png(pixels: NDArray[np.uint8]) -> bytes:
    """An (H, W, 3) picture as a PNG file's contents."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", optimize=True)
    return file.getvalue()
