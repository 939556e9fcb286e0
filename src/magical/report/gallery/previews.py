"""The scene of every environment and a rollout of its scripted expert, as image files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from gymnasium.utils.seeding import np_random

from magical.demos.generate import demonstrate
from magical.demos.store.reader import Frames
from magical.envs import EnvId
from magical.envs.vector.workers import defining_modules
from magical.experts import has_expert, modules_of
from magical.processes import checked_workers, map_in_processes
from magical.render import render_frame
from magical.report.figures.clips import Clip, encoded
from magical.report.gallery.descriptions import describe_scene
from magical.scene import Poses, View
from magical.scene.constants import CONTROL_RATE
from magical.tasks import Task, with_tasks

SIZE = 288  # pixels across
SPEED = 2  # of animations, a multiple of the benchmark's control rate
EVERY = 2  # control steps between frames
EFFORT = 50  # lossless compression effort, 0 to 100
_webp = partial(encoded, kind="WEBP", lossless=True, quality=EFFORT)
STILLS, ROLLOUTS = IMAGE_FOLDERS = "scenes", "rollouts"  # folders of the site


@dataclass(frozen=True, slots=True)
class EnvPreview:
    """What the gallery shows of one environment."""

    env_id: EnvId
    scene: str  # in words
    still: bytes  # the initial scene, a WebP file
    animation: bytes = b""  # the expert's rollout, an animated WebP file; empty without an expert
    score: float | None = None  # of the rollout; None without an expert

    @property
    def name(self) -> str:
        """The environment's HTML id on the page, such as `FindDupe-TestAll`."""
        return f"{self.env_id.task}-{self.env_id.variant}"

    @property
    def still_path(self) -> str:
        """The path of the scene's image, relative to the page."""
        return f"{STILLS}/{self.name}.webp"

    @property
    def animation_path(self) -> str:
        """The path of the rollout's animation, relative to the page."""
        return f"{ROLLOUTS}/{self.name}.webp"


def make_previews(
    env_ids: Sequence[EnvId], seed: int = 0, workers: int | None = None
) -> Iterator[EnvPreview]:
    """Render the scene of `reset(seed=seed)` and the expert's rollout in each environment.

    Args:
        env_ids: environments of registered tasks; a task without a scripted expert has no rollouts.
        seed: the seed of the scenes and of the expert.
        workers: processes, by default one per core. The result does not depend on it.

    Raises:
        InvalidTaskError: worker processes could not import a task.
    """
    count = checked_workers(workers)
    tasks = {env_id.task: env_id.task_spec for env_id in env_ids}
    modules = sorted({m for task in tasks.values() for m in _modules(task)}) if count > 1 else []
    return map_in_processes(with_tasks(partial(_make, seed), modules), env_ids, count)


def _make(seed: int, env_id: EnvId) -> EnvPreview:
    if not has_expert(env_id.task):
        scene, _ = env_id.task_spec.sample(env_id.variant, np_random(seed)[0])
        frame = render_frame(scene, Poses.at_rest(scene), View.ALLO, SIZE)
        return EnvPreview(env_id, describe_scene(scene), _webp(frame))
    trajectory = demonstrate(env_id, seed)
    last = len(trajectory)
    frames = Frames(trajectory, View.ALLO, SIZE).take([*range(0, last, EVERY), last])
    assert trajectory.score is not None  # its poses are known
    clip = Clip(trajectory.score, frames, EVERY)
    return EnvPreview(
        env_id,
        describe_scene(trajectory.scene),
        _webp(frames[0]),
        clip.webp(SPEED * CONTROL_RATE, EFFORT, lossless=True),
        clip.score,
    )


def _modules(task: Task) -> list[str]:
    """The modules that a new process must import to have the task and its expert."""
    return modules_of(task.name) if has_expert(task.name) else defining_modules([task])
