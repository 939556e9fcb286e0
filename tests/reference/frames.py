"""Compares the renderer with recorded frames (`frames-96.npz`, `frames-384.npz`)."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from magical.envs.ids import parse_env_id
from magical.files import write_atomically
from magical.render import Renderer
from magical.scene import Poses, Scene, View
from tests.reference.recordings import Comparison, expecting, scene_of

LIMIT = 0.25  # of 255: mean absolute difference over the frames of a task without regions
REGION_LIMIT = 0.5  # of 255: the same for a task with regions
FRAME_LIMIT = 1.0  # of 255: mean absolute difference of the worst single frame
UNIT = "of 255"
SIZES = (96, 384)  # pixels: the resolutions of the recordings, lowest first

FrameArray = NDArray[np.uint8]  # (N, size, size, 3)


@dataclass(frozen=True, slots=True)
class RecordedFrames:
    """N states and their frames in the recorded views."""

    scenes: tuple[Scene, ...]  # N
    poses: tuple[Poses, ...]  # N
    tasks: tuple[str, ...]  # N
    names: tuple[str, ...]  # N: environment, seed and step
    frames: Mapping[View, FrameArray]
    size: int  # pixels


def load(path: Path | str) -> RecordedFrames:
    """Read a frames file: the JSON string `records` and, if recorded, `allo` and `ego`.

    The format is described in the README of `data`. For a file without frames, `size` is 384 if
    the file's name contains 384, otherwise 96.

    Raises `RecordingError` for another file.
    """
    expected = "`records`, a JSON list, and perhaps `allo`, `ego` (N, size, size, 3) uint8"
    with expecting(path, f"an .npz file without pickled objects: {expected}"):
        with Path(path).open("rb") as file:
            arrays = dict(np.load(file, allow_pickle=False))
        frames = {view: arrays[view] for view in View if view in arrays}
        records = msgspec.json.decode(str(arrays["records"][()]), type=list[dict[str, Any]])
        found = {_check_frames(view, array, len(records)) for view, array in frames.items()}
        if len(found) > 1:
            raise ValueError(f"views of different sizes {sorted(found)}")
        scenes, poses = zip(*map(_state, records), strict=True)
        tasks = tuple(parse_env_id(str(record["env"])).task for record in records)
        names = tuple(f"{r['env']} seed {r.get('seed')} step {r.get('step')}" for r in records)
    size = SIZES[1] if str(SIZES[1]) in Path(path).name else SIZES[0]
    return RecordedFrames(scenes, poses, tasks, names, frames, next(iter(found), size))


def compute(data: RecordedFrames) -> dict[View, FrameArray]:
    """Render every state in both views at the recording's resolution."""
    shape = (len(data.scenes), data.size, data.size, 3)
    rendered = {view: np.empty(shape, np.uint8) for view in View}
    for i, (scene, poses) in enumerate(zip(data.scenes, data.poses, strict=True)):
        for view, frames in rendered.items():
            Renderer(scene, view, data.size).render(poses.bodies, frames[i])
    return rendered


def compare(data: RecordedFrames, computed: Mapping[View, FrameArray]) -> list[Comparison]:
    """Mean absolute differences for each task and view, and for the worst frame of each view."""
    comparisons = []
    for view, recorded in data.frames.items():
        differences = _differences(recorded, computed[view])
        for task in dict.fromkeys(data.tasks):
            indices = [i for i, name in enumerate(data.tasks) if name == task]
            limit = REGION_LIMIT if any(data.scenes[i].regions for i in indices) else LIMIT
            figure, exact = differences[indices].mean(), sum(differences[indices] == 0)
            detail = f"{len(indices)} frames, {exact} of them equal"
            name = f"{task} {view}"
            comparisons.append(Comparison(name, float(figure), limit, UNIT, detail))
        worst = int(differences.argmax())
        figure, name = float(differences[worst]), f"worst {view} frame"
        comparisons.append(Comparison(name, figure, FRAME_LIMIT, UNIT, data.names[worst]))
    return comparisons


def write(computed: Mapping[View, FrameArray], out: Path | str) -> None:
    """Write `allo` and `ego` as an .npz file, in the order of the records."""
    with write_atomically(out) as file:
        np.savez_compressed(file, allo=computed[View.ALLO], ego=computed[View.EGO])


def _differences(recorded: FrameArray, rendered: FrameArray) -> NDArray[np.float64]:
    """The mean absolute difference of each frame, (N,)."""
    pairs = zip(recorded, rendered, strict=True)
    return np.array([np.abs(a.astype(np.int16) - b).mean() for a, b in pairs])


def _check_frames(view: View, frames: NDArray[Any], count: int) -> int:
    """The size of the frames; raises `ValueError` for a wrong shape or type."""
    size = frames.shape[1] if frames.ndim == 4 else 0
    if frames.shape != (count, size, size, 3) or frames.dtype != np.uint8:
        raise ValueError(f"{count} records and `{view}` {frames.shape} of {frames.dtype}")
    return size


def _state(record: Mapping[str, Any]) -> tuple[Scene, Poses]:
    """The scene and the poses of one record."""
    order = record["draw_order"]
    robot_first = "Shape" in order and order.index("Robot") < order.index("Shape")
    scene = scene_of({**record, "robot_first": robot_first})
    x, y, _ = scene.robot
    fingers = zip(record["finger_positions"], record["finger_angles"], strict=True)
    rows = [
        scene.robot,
        *((*position, angle) for position, angle in fingers),
        *((x, y, angle) for angle in record["pupil_angles"]),
        *(block.pose for block in scene.blocks),
    ]
    bodies, expected = np.array(rows, np.float64), Poses.at_rest(scene).bodies.shape
    if bodies.shape != expected or not np.isfinite(bodies).all():
        raise ValueError(f"expected finite poses {expected}, found {bodies.shape}")
    return scene, Poses(bodies)
