"""Rollouts as animations: one episode in each environment, rendered and scored."""

import base64
import io
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation.policy import Policy, action_spec_of, is_privileged, observation_for
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import play
from magical.observe.arrays import select
from magical.observe.presets import make_spec
from magical.render import render_frame
from magical.scene import View
from magical.scene.constants import CONTROL_RATE

SIZE = 160  # pixels across
LAST_FRAME = 1.5  # seconds for which an animation shows its last frame


@dataclass(frozen=True, slots=True)
class Clip:
    """One rollout: the allocentric view every few control steps, and the final score."""

    score: float
    frames: NDArray[np.uint8]  # (F, H, W, 3)
    every: int = 1  # control steps between frames
    shown: NDArray[np.uint8] | None = None  # the policy's observation half-way, (H, W, 3)

    def webp(self, rate: float = CONTROL_RATE, quality: int = 70, lossless: bool = False) -> bytes:
        """A looping animated WebP, at `rate` control steps per second.

        If `lossless`, `quality` is the compression effort.
        """
        images = [Image.fromarray(frame) for frame in self.frames]
        step = round(1000 * self.every / rate)
        durations = [step] * (len(images) - 1) + [round(1000 * LAST_FRAME)]
        file = io.BytesIO()
        images[0].save(
            file,
            "WEBP",
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            quality=quality,
            lossless=lossless,
            method=3,
        )
        return file.getvalue()

    def strip(self, count: int = 6) -> NDArray[np.uint8]:
        """`count` frames from first to last, side by side, (H, W * count, 3)."""
        indices = np.linspace(0, len(self.frames) - 1, count).round().astype(int)
        return np.concatenate(list(self.frames[indices]), axis=1)


def record_rollouts(
    policy: Policy,
    evaluation: Evaluation,
    rollouts: Sequence[tuple[EnvId, int]],
    *,
    size: int = SIZE,
    every: int = 1,
) -> list[Clip]:
    """Run the policy again in some of an evaluation's rollouts, all of one task.

    Args:
        policy: see `Policy`.
        evaluation: how the policy was evaluated.
        rollouts: the environment and the rollout number of each.
        size: frame width and height in pixels.
        every: control steps between frames; the last step is always shown.

    Raises:
        PolicyError: the policy returned something other than actions.
    """
    env_ids = [env_id for env_id, _ in rollouts]
    seeds = [evaluation_seed(number, evaluation.seed) for _, number in rollouts]
    observation = observation_for(policy, evaluation.observation)
    with closing(
        MagicalVectorEnv(
            env_ids,
            workers=0,
            observation=observation,
            horizon=evaluation.horizon,
            action_space=action_spec_of(policy).name,
        )
    ) as envs:
        last = env_ids[0].task_spec.resolve_horizon(evaluation.horizon)
        shown: list[NDArray[np.uint8] | None] = [None for _ in env_ids]
        frames = []
        played = play(policy, envs, seeds, evaluation.nudge)
        for step, (observations, infos) in enumerate(played):
            if step == (last - 1) // 2 and not is_privileged(policy):
                spec = make_spec(observation, env_ids[0].task_spec)
                shown = [spec.picture(select(observations, row)) for row in range(len(env_ids))]
            if step % every == 0 or step == last:
                states = envs.states()
                frames.append([render_frame(s.scene, s.poses, View.ALLO, size) for s in states])
            scores: Any = infos.get("eval_score")  # at the end
    parts = zip(scores.tolist(), np.swapaxes(frames, 0, 1), shown, strict=True)
    return [Clip(score, own, every, image) for score, own, image in parts]


def data_uri(data: bytes, kind: str) -> str:
    """File contents as a data URI of a media type such as `image/webp`."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def encoded(pixels: NDArray[np.uint8], kind: str, **options: Any) -> bytes:
    """An (H, W, 3) image encoded in a format such as `PNG`; `options` are Pillow's."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()
