"""Demonstrations whose frames are rendered when sampled, and augmented by the rendering itself.

The camera is rotated and shifted and the palette is changed in CIE Lab, so an augmented frame costs
as much as a plain one, and pixels are never resampled. This needs poses: demonstrations by scripted
experts have them, and so have the published human ones when read by `magical demos import`.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.demos import Trajectory
from magical.errors import DemonstrationsError
from magical.grouping import group_by
from magical.observe import ObservationSpec, PixelSpec
from magical.render.moved_camera import MovedCamera
from magical.render.palette import permuted
from magical.scene import Scene
from magical_baselines.augmentation.augment import (
    NOISE_STD,
    Parameters,
    noise_seeds,
    sample_parameters,
)
from magical_baselines.augmentation.colour import colour_jitter
from magical_baselines.augmentation.names import SETS, Augmentations
from magical_baselines.augmentation.noise import add_noise
from magical_baselines.augmentation.palette import PERMUTATIONS
from magical_baselines.augmentation.transformations import WALLS, StackTransformations
from magical_baselines.data.expert_data import ExpertData, Rows, TaskTrajectories
from magical_baselines.running.run import Run

AUTO, RENDERING, RESAMPLING = "auto", "rendering", "resampling"  # how images are augmented


def choose_image_data(
    demonstrations: TaskTrajectories,
    run: Run,
    spec: ObservationSpec,
    augment_by: str,
    transformations: Collection[str] = (),
) -> type[ExpertData]:
    """Choose how samples get their images, and record it in `run.json`; `auto` renders if possible.

    Raises:
        DemonstrationsError: rendering, or a transformation that needs it, was requested, but poses
            are unknown or the observation is not one that the package renders.
    """
    unknown = [trajectory.env_id for _, trajectory in demonstrations if trajectory.poses is None]
    reason = ""
    if not isinstance(spec, PixelSpec):
        reason = "the observation is not made of the package's frames"
    elif unknown:
        reason = (
            f"{len(unknown)} demonstrations have recorded frames only (the first is of "
            f"{unknown[0]}); `magical demos import` recovers poses of the published files"
        )
    if reason and (augment_by == RENDERING or WALLS in transformations):
        option = "augment_by: rendering" if augment_by == RENDERING else f"transform: {WALLS}"
        raise DemonstrationsError(f"{option} needs frames that can be rendered, but {reason}")
    if augment_by == AUTO:
        augment_by = RESAMPLING if reason else RENDERING
    run.describe(augment_by=augment_by)
    return RenderedExpertData if augment_by == RENDERING else ExpertData


class RenderedExpertData(ExpertData):
    """Like `ExpertData`, but without stored frames; only for pixel observations."""

    def _load_frames(self, trajectories: Sequence[Trajectory]) -> None:
        """Store all poses before actions, grouped by scene: scenes differ in bodies or regions."""
        assert isinstance(self.spec, PixelSpec)
        ends = np.cumsum(list(map(len, trajectories)))
        with_frames = zip(trajectories, np.split(np.arange(ends[-1]), ends[:-1]), strict=True)
        by_scene = group_by(with_frames, lambda pair: _what_is_rendered(pair[0].scene))
        self._scene_of, self._row_of = np.empty((2, ends[-1]), np.intp)  # by frame
        self._scenes: list[_SceneData] = []
        for number, members in enumerate(by_scene.values()):
            frames = np.concatenate([own for _, own in members])
            self._scene_of[frames], self._row_of[frames] = number, np.arange(len(frames))
            poses = [np.asarray(trajectory.poses)[:-1] for trajectory, _ in members]
            scene, parts = members[0][0].scene, self.spec.components
            cameras = [MovedCamera(scene, part.view, part.size, part.samples) for part in parts]
            palettes = [
                np.stack([permuted(camera.palette, colours) for colours in PERMUTATIONS])
                for camera in cameras
            ]
            self._scenes.append(_SceneData(np.concatenate(poses), cameras, palettes))

    @property
    def batches_on_host(self) -> bool:
        """See `ExpertData`: frames are always rendered by the host."""
        return True

    def images(self, rows: Rows, newest_only: NDArray[np.bool_] | None = None) -> Tensor:
        """See `ExpertData`: the frames without augmentation."""
        unchanged = StackTransformations.none(len(rows))
        if newest_only is not None:
            unchanged = replace(unchanged, newest_only=newest_only)
        plain = self.augmented(rows, SETS["none"], np.random.default_rng(0), unchanged)
        return plain.mul(255.0).round_().to(torch.uint8).contiguous()

    def augmented(
        self,
        rows: Rows,
        which: Augmentations,
        rng: np.random.Generator,
        transformed: StackTransformations | None = None,
        together: int = 1,
    ) -> Tensor:
        """See `ExpertData`."""
        transformed = transformed or StackTransformations.none(len(rows))
        channels, height, width = self.spec.network_shape
        parameters = sample_parameters(len(rows), which, rng, together)
        images = torch.empty((len(rows), height, width, channels))
        out = images.numpy()
        stacks = [stack.cpu().numpy()[rows] for stack in self._stacks]  # (B, K) each
        for stack in stacks:
            stack[transformed.newest_only] = stack[transformed.newest_only, -1:]
        scenes = self._scene_of[stacks[0][:, 0]]
        for number in np.unique(scenes):
            inside = np.flatnonzero(scenes == number)
            self._scenes[number].render(
                [self._row_of[stack[inside]] for stack in stacks],
                parameters,
                which,
                transformed,
                out,
                inside,
            )
        out[transformed.mirrored] = out[transformed.mirrored, :, ::-1]
        if which.noise:
            add_noise(out, NOISE_STD, noise_seeds(len(rows), rng))
        return images.permute(0, 3, 1, 2).to(self.device)


class _SceneData(NamedTuple):
    """What is needed to render the frames of one scene."""

    poses: NDArray[np.float64]  # (F, bodies, 3)
    cameras: list[MovedCamera]  # one for each component of the observation
    palettes: list[NDArray[np.uint8]]  # for each camera: (24, n, 3), by index into `PERMUTATIONS`

    def render(
        self,
        stacks: Sequence[NDArray[np.intp]],
        parameters: Parameters,
        which: Augmentations,
        transformed: StackTransformations,
        out: NDArray[np.float32],
        rows: NDArray[np.intp],
    ) -> None:
        """Render stacks (B, K), one array for each camera, into `out[rows]`."""
        channel = 0
        views = zip(self.cameras, self.palettes, stacks, strict=True)
        for camera, palettes, frames in views:
            camera.render(
                self.poses[frames],
                parameters.angles[rows],
                parameters.shifts[rows],
                _jittered(palettes[transformed.palettes[rows]], parameters, which, rows),
                transformed.without_walls[rows],
                out,
                rows,
                channel,
            )
            channel += 3 * frames.shape[1]


def _jittered(
    palettes: NDArray[np.uint8],
    parameters: Parameters,
    which: Augmentations,
    rows: NDArray[np.intp],
) -> NDArray[np.uint8]:
    """Apply each stack's colour jitter to palettes (B, n, 3)."""
    if not which.colour:
        return palettes
    images = torch.from_numpy(palettes.transpose(0, 2, 1)[:, :, None].copy())  # (B, 3, 1, n)
    scales, hues = parameters.lightness[rows], parameters.hues[rows]
    jittered = colour_jitter(images, scales, hues, which.linear_light)
    rounded = jittered.mul_(255.0).round_().to(torch.uint8)
    return rounded[:, :, 0].permute(0, 2, 1).numpy()


def _what_is_rendered(scene: Scene) -> object:
    """A key, equal for scenes with the same regions and the same bodies in the same order."""
    blocks = tuple((block.shape, block.colour) for block in scene.blocks)
    return blocks, scene.regions, scene.robot_first
