"""Films of demonstrations: both views side by side, with the score."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.reader import Frames
from magical.demos.store.trajectory import VIEWS, Trajectory
from magical.errors import UnknownNameError
from magical.files import write_atomically
from magical.scene import Poses
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE, RAW_FRAME_SIZE

SIZE = RAW_FRAME_SIZE  # pixels across of each view
BANNER = 32  # pixels high, above the pictures
LAST_FRAME_REPEATS = 12  # of the last moment of a demonstration
SUFFIXES = (".mp4", ".webp")
_PAPER, _INK = (255, 255, 255), (60, 60, 70)

Picture = NDArray[np.uint8]


def write_video(trajectories: Iterable[Trajectory], path: Path, rate: float = CONTROL_RATE) -> int:
    """Write one film of all trajectories, one after another, and return its number of frames.

    The suffix chooses the format: `.mp4` (H.264, needs the `video` extra) or `.webp` (animated).

    Raises:
        UnknownNameError: another suffix.
        ModuleNotFoundError: the extra is not installed.
        OSError: the file cannot be written; nothing is left behind.
    """
    if path.suffix not in SUFFIXES:
        raise UnknownNameError(f"{path}: expected a film's suffix {' or '.join(SUFFIXES)}")
    pictures = (picture for one in trajectories for picture in film(one))
    return (_write_mp4 if path.suffix == ".mp4" else _write_webp)(pictures, path, rate)


def film(trajectory: Trajectory) -> Iterator[Picture]:
    """The pictures of one demonstration, (BANNER + SIZE, 2 * SIZE, 3) uint8.

    With poses, both views are drawn at this size and the score is that of each moment; recorded
    pictures are enlarged, and only the last moment's score is known.
    """
    views = [view for view in VIEWS if _has(trajectory, view)]
    size = SIZE if trajectory.poses is not None else FRAME_SIZE
    frames = [Frames(trajectory, view, size) for view in views]
    shown: Any = None
    for time in range(len(trajectory) + 1):
        parts = [one.take([time])[0] for one in frames]
        pictures = [part.repeat(SIZE // size, 0).repeat(SIZE // size, 1) for part in parts]
        shown = np.concatenate([_banner(trajectory, time, SIZE * len(views)), _joined(pictures)])
        yield shown
    for _ in range(LAST_FRAME_REPEATS):
        yield shown


def _joined(pictures: list[Picture]) -> Picture:
    return np.concatenate(pictures, axis=1)


def _has(trajectory: Trajectory, view: str) -> bool:
    return trajectory.frames is None or view in trajectory.frames


def _banner(trajectory: Trajectory, time: int, width: int) -> Picture:
    from PIL import Image, ImageDraw, ImageFont  # pictures are needed nowhere else here

    picture = Image.new("RGB", (width, BANNER), _PAPER)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=16)
    left = f"{trajectory.env_id.task} {trajectory.env_id.variant}, {trajectory.demonstrator}"
    right = f"step {time}/{len(trajectory)}   {_score(trajectory, time)}"
    draw.text((8, 6), left, _INK, font)
    draw.text((width - 8, 6), right, _INK, font, anchor="ra")
    return np.asarray(picture)


def _score(trajectory: Trajectory, time: int) -> str:
    if trajectory.poses is not None:
        score = trajectory.task.score(trajectory.scene, Poses(trajectory.poses[time]))
        return f"score {score:.2f}"
    last = time == len(trajectory)
    return f"score {trajectory.published_code_score:.2f}" if last else "score  ...  "


def _write_mp4(pictures: Iterable[Picture], path: Path, rate: float) -> int:
    import imageio_ffmpeg

    count = 0
    with write_atomically(path) as file:
        # The encoder wants a path of its own; its film then goes where only whole files appear.
        temporary = Path(file.name).with_suffix(".mp4")
        writer: Any = None
        try:
            for picture in pictures:
                if writer is None:
                    writer = imageio_ffmpeg.write_frames(
                        str(temporary),
                        (picture.shape[1], picture.shape[0]),
                        fps=rate,
                        codec="libx264",
                        quality=8,
                        macro_block_size=2,
                    )
                    writer.send(None)
                writer.send(np.ascontiguousarray(picture))
                count += 1
            if writer is not None:
                writer.close()
                writer = None
                file.write(temporary.read_bytes())
        finally:
            if writer is not None:
                writer.close()
            temporary.unlink(missing_ok=True)
    return count


def _write_webp(pictures: Iterable[Picture], path: Path, rate: float) -> int:
    from PIL import Image

    images = [Image.fromarray(picture) for picture in pictures]
    duration = round(1000 / rate)
    with write_atomically(path) as file:
        images[0].save(
            file,
            format="WEBP",
            save_all=True,
            append_images=images[1:],
            duration=duration,
            loop=0,
            quality=80,
            method=2,
        )
    return len(images)
