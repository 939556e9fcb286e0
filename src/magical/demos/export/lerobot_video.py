"""Films as a LeRobotDataset wants them: H.264 with a key frame every other frame."""

from fractions import Fraction
from pathlib import Path
from types import MappingProxyType

import av
import numpy as np
from av.video.stream import VideoStream
from numpy.typing import NDArray

from magical.scene.constants import FRAME_SIZE

# Full colour resolution: halved, as is usual, outlines two pixels wide would lose their colour.
CODEC, PIXEL_FORMAT = "libx264", "yuv444p"
OPTIONS = {"crf": "12", "g": "2", "bf": "0"}  # hardly lossy; seekable to any frame
VIDEO_INFO = MappingProxyType(
    {
        "video.height": FRAME_SIZE,
        "video.width": FRAME_SIZE,
        "video.codec": "h264",
        "video.pix_fmt": PIXEL_FORMAT,
        "is_depth_map": False,
        "video.channels": 3,
        "has_audio": False,
    }
)


class Film:
    """One film that is being written; frame k is shown at k / fps seconds."""

    def __init__(self, path: Path, fps: int) -> None:
        self._container = av.open(str(path), "w")
        stream = self._container.add_stream(CODEC, rate=fps, options=dict(OPTIONS))
        assert isinstance(stream, VideoStream)
        stream.width = stream.height = FRAME_SIZE
        stream.pix_fmt = PIXEL_FORMAT
        self._stream = stream
        self._step = Fraction(1, fps)
        self._count = 0

    def write(self, frames: NDArray[np.uint8]) -> None:
        """Append pictures (T, 96, 96, 3)."""
        for picture in frames:
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = self._count, self._step
            self._container.mux(self._stream.encode(frame))
            self._count += 1

    def __enter__(self) -> "Film":
        return self

    def __exit__(self, *error: object) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()
