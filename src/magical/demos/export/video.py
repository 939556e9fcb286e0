"""Videos of demonstrations: both views side by side, with the score."""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import IO, Any, Self

import numpy as np
import PIL.Image
from numpy.typing import NDArray
from PIL import ImageDraw, ImageFont

from magical.demos.store.reader import Frames
from magical.demos.store.trajectory import VIEWS, Trajectory
from magical.errors import DatasetError, UnknownNameError
from magical.extras import require
from magical.files import write_atomically
from magical.messages import printable
from magical.scene import Poses
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE, RAW_FRAME_SIZE

SIZE = RAW_FRAME_SIZE  # pixels across each view
BANNER = 32  # pixels high, above the frames
MAX_WEBP_FRAMES = 2000  # about 1 MB each, all in memory
LAST_FRAME_REPEATS = 12  # of the final frame of a demonstration
SUFFIXES = (".mp4", ".webp")
_BACKGROUND, _TEXT = (255, 255, 255), (60, 60, 70)

Image = NDArray[np.uint8]


def write_video(trajectories: Iterable[Trajectory], path: Path | str) -> int:
    """Write one video of all trajectories, one after another; returns its number of frames.

    The suffix chooses the format: `.mp4` (H.264, needs the `video` extra) or `.webp` (animated).

    Raises:
        UnknownNameError: the suffix is neither.
        MissingDependencyError: the extra is not installed.
        DatasetError: there are no trajectories, they have different views, or there are more than
            `MAX_WEBP_FRAMES` frames for `.webp`.
        OSError: the file cannot be written; no partial file remains.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise UnknownNameError(f"{target}: expected the suffix {' or '.join(SUFFIXES)}")
    if suffix == ".mp4":
        require("video")
    frames = (frame for trajectory in trajectories for frame in video_frames(trajectory))
    if (first := next(frames, None)) is None:
        raise DatasetError(f"{target}: expected trajectories to show, found none")
    write = _write_mp4 if suffix == ".mp4" else _write_webp
    return write(_of_one_size(chain([first], frames), first.shape), target)


def _of_one_size(frames: Iterable[Image], shape: tuple[int, ...]) -> Iterator[Image]:
    for frame in frames:
        if frame.shape != shape:
            raise DatasetError("expected trajectories with the same views, found different ones")
        yield frame


def video_frames(trajectory: Trajectory) -> Iterator[Image]:
    """The frames of one demonstration, (BANNER + SIZE, SIZE * number of views, 3) uint8.

    With poses, both views are rendered at this size, with the score at each time step. Recorded
    frames are enlarged, and only the final score is known.
    """
    known = VIEWS if trajectory.frames is None else trajectory.frames
    views = [view for view in VIEWS if trajectory.poses is not None or view in known]
    size = FRAME_SIZE if trajectory.poses is None else SIZE
    sources = [Frames(trajectory, view, size) for view in views]
    frame: Any = None
    for time in range(len(trajectory) + 1):
        images = [source.take([time])[0] for source in sources]
        enlarged = [image.repeat(SIZE // size, 0).repeat(SIZE // size, 1) for image in images]
        banner = _banner(trajectory, time, SIZE * len(views))
        frame = np.concatenate([banner, np.concatenate(enlarged, axis=1)])
        yield frame
    for _ in range(LAST_FRAME_REPEATS):
        yield frame


def _banner(trajectory: Trajectory, time: int, width: int) -> Image:
    image = PIL.Image.new("RGB", (width, BANNER), _BACKGROUND)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=16)
    demonstrator = printable(trajectory.demonstrator, 40)
    left = f"{trajectory.env_id.task} {trajectory.env_id.variant}, {demonstrator}"
    right = f"step {time}/{len(trajectory)}   {_score(trajectory, time)}"
    draw.text((8, 6), left, _TEXT, font)
    draw.text((width - 8, 6), right, _TEXT, font, anchor="ra")
    return np.asarray(image)


def _score(trajectory: Trajectory, time: int) -> str:
    if trajectory.poses is not None:
        score = trajectory.task.score(trajectory.scene, Poses(trajectory.poses[time]))
        return f"score {score:.2f}"
    last = time == len(trajectory)
    return f"score {trajectory.published_code_score:.2f}" if last else "score  ...  "


class Mp4Writer:
    """Writes an MP4 file in H.264; frame k has the timestamp k / rate seconds."""

    def __init__(
        self, file: Path | IO[bytes], rate: float, pixel_format: str, options: Mapping[str, str]
    ) -> None:
        """`options` are passed to the encoder libx264."""
        import av

        self._container = av.open(file, "w", format="mp4")
        self._rate = Fraction(rate)
        self._stream: Any = self._container.add_stream("libx264", self._rate, dict(options))
        self._stream.pix_fmt = pixel_format
        self.count = 0

    def write(self, image: Image) -> None:
        """Append a frame (H, W, 3) uint8; all must have the size of the first."""
        from av import VideoFrame

        if not self.count:
            self._stream.height, self._stream.width = image.shape[:2]
        frame = VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        frame.pts, frame.time_base = self.count, 1 / self._rate
        self._container.mux(self._stream.encode(frame))
        self.count += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self.count:
            self._container.mux(self._stream.encode())
        self._container.close()


def _write_mp4(frames: Iterable[Image], path: Path) -> int:
    with (
        write_atomically(path) as file,
        Mp4Writer(file, CONTROL_RATE, "yuv420p", {"qp": "10"}) as video,
    ):
        for frame in frames:
            video.write(frame)
    return video.count


def _write_webp(frames: Iterable[Image], path: Path) -> int:
    images = [PIL.Image.fromarray(frame) for frame in islice(frames, MAX_WEBP_FRAMES + 1)]
    if len(images) > MAX_WEBP_FRAMES:
        raise DatasetError(
            f"{path}: expected at most {MAX_WEBP_FRAMES} frames for .webp, which are all kept in "
            "memory; select fewer demonstrations, or write .mp4"
        )
    options = {"duration": round(1000 / CONTROL_RATE), "loop": 0, "quality": 80, "method": 2}
    with write_atomically(path) as file:
        images[0].save(file, "WEBP", save_all=True, append_images=images[1:], **options)
    return len(images)
