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
from magical.evaluation.policy import (
    Policy,
    checked_actions,
    given_to,
    is_privileged,
    observation_for,
)
from magical.evaluation.protocol import Evaluation
from magical.evaluation.seeds import RolloutRng
from magical.observe import ObservationSpec
from magical.observe.arrays import select
from magical.observe.presets import make_spec
from magical.render import Renderer
from magical.scene import State, View
from magical.scene.constants import CONTROL_RATE

SIZE = 160  # pixels across
LAST_FRAME = 1.5  # seconds that an animation shows its last frame


@dataclass(frozen=True, slots=True)
class Clip:
    """One rollout, the allocentric view every few control steps, and its final score."""

    env_id: EnvId
    score: float
    frames: NDArray[np.uint8]  # (F, H, W, 3)
    every: int = 1  # control steps between frames
    shown: NDArray[np.uint8] | None = None  # what the policy got half-way, (H, W, 3)

    def webp(self, rate: float = CONTROL_RATE, quality: int = 70, lossless: bool = False) -> bytes:
        """An animated WebP that loops, at `rate` control steps a second.

        If `lossless`, `quality` is the effort of compression.
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
        """`count` frames from first to last side by side, (H, W * count, 3)."""
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
        evaluation: how it was evaluated.
        rollouts: the environment and the number of each.
        size: pixels across a frame.
        every: control steps between frames; the last step is always shown.

    Raises:
        PolicyError: the policy returned something else than actions.
    """
    env_ids = [env_id for env_id, _ in rollouts]
    seeds = [evaluation_seed(number, evaluation.seed) for _, number in rollouts]
    observation = observation_for(policy, evaluation.observation)
    options = {"nudge": evaluation.nudge} if evaluation.nudge else None
    horizon = evaluation.horizon
    with closing(
        MagicalVectorEnv(env_ids, workers=0, observation=observation, horizon=horizon)
    ) as envs:
        rng = RolloutRng(env_ids, seeds)
        observations, info = envs.reset(seed=seeds, options=options)
        policy.reset(np.ones(len(env_ids), np.bool_))
        states = envs.states()
        film, last = _Film(states, size), states[0].horizon
        for step in range(1, last + 1):
            if step == (last + 1) // 2 and not is_privileged(policy):
                film.shown = _pictures(make_spec(observation, env_ids[0].task_spec), observations)
            given = given_to(policy, envs, observations)
            actions = checked_actions(policy.act(given, env_ids, rng), len(env_ids))
            observations, _, _, _, info = envs.step(actions)
            states = envs.states()
            if step % every == 0 or step == last:
                film.add(states)
    return film.clips(env_ids, info["eval_score"].tolist(), every)


class _Film:
    """The frames of several rollouts."""

    def __init__(self, states: Sequence[State], size: int) -> None:
        self._renderers = [Renderer(state.scene, View.ALLO, size) for state in states]
        self._frames: list[list[NDArray[np.uint8]]] = [[] for _ in states]
        self.shown: list[NDArray[np.uint8] | None] = [None for _ in states]
        self.add(states)

    def add(self, states: Sequence[State]) -> None:
        """Render every rollout's present state."""
        for renderer, frames, state in zip(self._renderers, self._frames, states, strict=True):
            frame = np.empty((renderer.size, renderer.size, 3), np.uint8)
            renderer.render(state.poses.bodies, frame)
            frames.append(frame)

    def clips(self, env_ids: Sequence[EnvId], scores: Sequence[float], every: int) -> list[Clip]:
        """The rollouts as clips, after their end."""
        parts = zip(env_ids, scores, self._frames, self.shown, strict=True)
        return [
            Clip(env_id, s, np.array(frames), every, shown) for env_id, s, frames, shown in parts
        ]


def _pictures(spec: ObservationSpec, observations: Any) -> list[NDArray[np.uint8] | None]:
    """What the policy is shown in each environment; nothing for what is no image."""
    count = len(
        next(iter(observations.values())) if isinstance(observations, dict) else observations
    )
    return [spec.picture(select(observations, row)) for row in range(count)]


def data_uri(data: bytes, kind: str) -> str:
    """File contents as a data URI, for instance of kind `image/webp`."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def png(pixels: NDArray[np.uint8]) -> bytes:
    """An (H, W, 3) image as a PNG file's contents."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", optimize=True)
    return file.getvalue()
