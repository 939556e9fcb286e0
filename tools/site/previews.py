"""The scene of every environment and a rollout of its scripted expert, as image files."""

import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.demos.generate import demonstrate
from magical.demos.trajectory import Frames
from magical.envs import EnvId
from magical.processes import checked_workers, map_in_processes
from magical.report.figures import Clip
from magical.scene import Scene, View
from magical.scene.constants import CONTROL_RATE

SIZE = 288  # pixels across
SPEED = 2  # of animations, a multiple of the benchmark's control rate
EVERY = 2  # control steps between frames
EFFORT = 50  # lossless compression effort, 0 to 100


@dataclass(frozen=True, slots=True)
class EnvPreview:
    """What the site shows of one environment."""

    env_id: EnvId
    scene: str  # in words
    still: bytes  # the initial scene, a WebP file
    animation: bytes  # the expert's rollout, an animated WebP file
    score: float  # of the rollout

    @property
    def name(self) -> str:
        """The environment's task and variant, such as `FindDupe-TestAll`."""
        return f"{self.env_id.task}-{self.env_id.variant}"


def make_previews(
    env_ids: Sequence[EnvId], seed: int = 0, workers: int | None = None
) -> Iterator[EnvPreview]:
    """Render the scene of `reset(seed=seed)` and the expert's rollout in each environment.

    Args:
        env_ids: environments of tasks with a scripted expert.
        seed: the seed of the scenes and of the expert.
        workers: processes, by default one per core. The result does not depend on it.
    """
    return map_in_processes(partial(_make, seed), env_ids, checked_workers(workers))


def _make(seed: int, env_id: EnvId) -> EnvPreview:
    trajectory = demonstrate(env_id, seed)
    last = len(trajectory)
    frames = Frames(trajectory, View.ALLO, SIZE).take([*range(0, last, EVERY), last])
    assert trajectory.score is not None  # its poses are known
    clip = Clip(trajectory.score, frames, EVERY)
    return EnvPreview(
        env_id,
        describe_scene(trajectory.scene),
        encoded(frames[0], "WEBP", lossless=True, quality=EFFORT),
        clip.webp(SPEED * CONTROL_RATE, EFFORT, lossless=True),
        clip.score,
    )


def describe_scene(scene: Scene) -> str:
    """The contents of a scene, such as `a robot, 1 blue goal region, 2 red squares`."""
    kinds = [f"{region.colour} goal region" for region in scene.regions]
    kinds += [f"{block.colour} {block.shape}" for block in scene.blocks]
    counted = [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in Counter(kinds).items()]
    return ", ".join(["a robot", *counted])


def encoded(pixels: NDArray[np.uint8], kind: str, **options: Any) -> bytes:
    """An (H, W, 3) image encoded in a format such as `PNG`; `options` are Pillow's."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()
