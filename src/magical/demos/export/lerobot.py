"""Export to a LeRobotDataset v3.0: Parquet tables, a video for each camera, and metadata.

The layout follows the format's documentation and its reference writer: `meta/info.json`,
`meta/stats.json`, `meta/tasks.parquet`, `meta/episodes/`, `data/`, `videos/<camera>/`. Episodes are
concatenated into large files; `meta/episodes` has the position of each. Needs the `lerobot` extra.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from av.video.stream import VideoStream
from numpy.typing import NDArray

import magical
from magical.demos.store.dataset import Dataset
from magical.demos.store.reader import Frames
from magical.demos.store.trajectory import VIEWS, Trajectory
from magical.errors import DatasetError
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE
from magical.scene.poses import FINGERS, ROBOT

VERSION = "v3.0"
FILES_PER_CHUNK = 1000
FRAMES_PER_FILE = 50_000  # at which the next files are started
FPS = int(CONTROL_RATE)
CAMERAS = {view: f"observation.images.{view}" for view in VIEWS}
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_STATE = ("robot_x", "robot_y", "robot_angle", "left_finger_angle", "right_finger_angle")
_INDICES = ("frame_index", "episode_index", "index", "task_index")

# Chroma at full resolution: with the usual subsampling, outlines two pixels wide lose their colour.
CODEC, PIXEL_FORMAT = "libx264", "yuv444p"
OPTIONS = {"crf": "12", "g": "2", "bf": "0"}  # nearly lossless; a key frame every other frame
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

Columns = dict[str, NDArray[Any]]
Floats = NDArray[np.float64]


def export_lerobot(
    dataset: Dataset, folder: Path, *, frames_per_file: int = FRAMES_PER_FILE
) -> int:
    """Write the dataset into a new folder; returns the number of frames, one for each action.

    Features: both cameras at 96 x 96 (H.264, slightly lossy), `action` (int64, 0 to 17),
    `next.done`, and where all poses are known `observation.state` (robot pose and finger angles).
    `action` is the one to imitate; where some trajectory has others that were executed, those are
    `executed_action`.
    Scores, demonstrator and environment id are columns of `meta/episodes`.

    Raises:
        DatasetError: the folder exists, the dataset is empty or a trajectory is damaged; no partial
            export remains.
    """
    if folder.exists() or not len(dataset):
        found = f"{folder}, which exists" if len(dataset) else "no trajectories"
        raise DatasetError(f"export: expected trajectories and a new folder, found {found}")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".part-") as temporary:
        root = Path(temporary) / folder.name
        with _Writer(root, dataset) as writer:
            for entry, trajectory in zip(dataset.entries, dataset, strict=True):
                if writer.frames_in_file >= frames_per_file:
                    writer.start_files()
                writer.add(trajectory, {"demonstrator": entry.demonstrator})
        writer.finish()
        root.rename(folder)
    return writer.total


class _Writer:
    """The open files of an export: one table, and one video for each camera."""

    def __init__(self, root: Path, dataset: Dataset) -> None:
        self.root = root
        self.total = 0
        self.frames_in_file = 0
        self._with_state = all(entry.has_poses for entry in dataset.entries)
        self._with_executed = any(trajectory.expert_actions is not None for trajectory in dataset)
        self._tasks: dict[str, int] = {}
        self._episodes: list[dict[str, Any]] = []
        self._stats: list[dict[str, Stats]] = []
        self._file = -1
        self._open = ExitStack()

    def __enter__(self) -> "_Writer":
        self.start_files()
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    def start_files(self) -> None:
        """Close the files, and start the next ones."""
        self._open.close()
        self._file += 1
        self.frames_in_file = 0
        path = self._path("data", "parquet")
        self._table = self._open.enter_context(pq.ParquetWriter(path, self._schema()))
        self._videos = {
            view: self._open.enter_context(_Video(self._path(f"videos/{camera}", "mp4"), FPS))
            for view, camera in CAMERAS.items()
        }

    def add(self, trajectory: Trajectory, columns: Mapping[str, Any]) -> None:
        """Write one episode: the frame before each action, and the action.

        `columns` are added to the episode's row in `meta/episodes`.
        """
        steps = len(trajectory)
        task = self._tasks.setdefault(trajectory.task.summary, len(self._tasks))
        data = self._columns(trajectory, task)
        stats = {name: Stats.of(column) for name, column in data.items()}
        arrays = {name: _arrow(column) for name, column in data.items()}
        self._table.write_table(pa.table(arrays, schema=self._schema()))
        for view, video in self._videos.items():
            frames = Frames(trajectory, view, FRAME_SIZE).take(np.arange(steps))
            video.write(frames)
            stats[CAMERAS[view]] = Stats.of_frames(frames)
        self._episodes.append({**self._episode(trajectory), **columns})
        self._stats.append(stats)
        self.total += steps
        self.frames_in_file += steps

    def finish(self) -> None:
        """Write the metadata of the closed files."""
        meta = self.root / "meta"
        rows = [
            {**row, **_flat(stats)} for row, stats in zip(self._episodes, self._stats, strict=True)
        ]
        path = meta / "episodes" / f"{_FILE.format(chunk_index=0, file_index=0)}.parquet"
        path.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(rows), path)
        pq.write_table(_task_table(list(self._tasks)), meta / "tasks.parquet")
        _write_json(meta / "stats.json", {k: v.plain() for k, v in merged(self._stats).items()})
        _write_json(meta / "info.json", self._info())

    def _columns(self, trajectory: Trajectory, task: int) -> Columns:
        steps = len(trajectory)
        frame = np.arange(steps)
        columns: Columns = {"action": trajectory.labels, "next.done": frame == steps - 1}
        if self._with_executed:
            columns["executed_action"] = trajectory.actions
        if self._with_state:
            assert trajectory.poses is not None
            columns["observation.state"] = _robot_states(trajectory.poses[:-1])
        return columns | {
            "timestamp": (frame / FPS).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(steps, len(self._episodes)),
            "index": self.total + frame,
            "task_index": np.full(steps, task),
        }

    def _episode(self, trajectory: Trajectory) -> dict[str, Any]:
        steps, start = len(trajectory), self.frames_in_file
        chunk, file = divmod(self._file, FILES_PER_CHUNK)
        row: dict[str, Any] = {
            "episode_index": len(self._episodes),
            "tasks": [trajectory.task.summary],
            "length": steps,
            "dataset_from_index": self.total,
            "dataset_to_index": self.total + steps,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "env_id": str(trajectory.env_id),
            "score": trajectory.score,
            "published_code_score": trajectory.published_code_score,
        }
        for camera in CAMERAS.values():
            row[f"videos/{camera}/chunk_index"] = chunk
            row[f"videos/{camera}/file_index"] = file
            row[f"videos/{camera}/from_timestamp"] = start / FPS
            row[f"videos/{camera}/to_timestamp"] = (start + steps) / FPS
        return row

    def _schema(self) -> Any:
        state = [("observation.state", pa.list_(pa.float32(), len(_STATE)))]
        executed = [("executed_action", pa.int64())]
        return pa.schema(
            [
                ("action", pa.int64()),
                ("next.done", pa.bool_()),
                *(executed if self._with_executed else []),
                *(state if self._with_state else []),
                ("timestamp", pa.float32()),
                *((name, pa.int64()) for name in _INDICES),
            ]
        )

    def _features(self) -> dict[str, Any]:
        def feature(dtype: str, names: Sequence[str] | None = None) -> dict[str, Any]:
            return {"dtype": dtype, "shape": [len(names or "1")], "names": names}

        camera = {
            "dtype": "video",
            "shape": [FRAME_SIZE, FRAME_SIZE, 3],
            "names": ["height", "width", "channels"],
            "info": VIDEO_INFO | {"video.fps": FPS},
        }
        return {
            **dict.fromkeys(CAMERAS.values(), camera),
            **({"observation.state": feature("float32", _STATE)} if self._with_state else {}),
            "action": feature("int64", ["action"]),
            "next.done": feature("bool"),
            **({"executed_action": feature("int64")} if self._with_executed else {}),
            "timestamp": feature("float32"),
            **{name: feature("int64") for name in _INDICES},
        }

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
            "robot_type": "magical",
            "total_episodes": len(self._episodes),
            "total_frames": self.total,
            "total_tasks": len(self._tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 500,
            "fps": FPS,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": f"data/{_FILE}.parquet",
            "video_path": f"videos/{{video_key}}/{_FILE}.mp4",
            "features": self._features(),
            "exported_by": f"magical {magical.__version__}",
        }

    def _path(self, folder: str, suffix: str) -> Path:
        chunk, file = divmod(self._file, FILES_PER_CHUNK)
        name = _FILE.format(chunk_index=chunk, file_index=file)
        path = self.root / folder / f"{name}.{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


class _Video:
    """A video file being written; frame k has the timestamp k / fps seconds."""

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
        """Append frames (T, 96, 96, 3) uint8."""
        for array in frames:
            frame = av.VideoFrame.from_ndarray(array, format="rgb24")
            frame.pts, frame.time_base = self._count, self._step
            self._container.mux(self._stream.encode(frame))
            self._count += 1

    def __enter__(self) -> "_Video":
        return self

    def __exit__(self, *error: object) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()


@dataclass(frozen=True, slots=True)
class Stats:
    """Statistics of one feature, as a LeRobotDataset has them."""

    min: Floats  # (D,), or (3, 1, 1) for cameras, on [0, 1]
    max: Floats
    mean: Floats
    std: Floats
    count: NDArray[np.int64]  # (1,), number of values

    @staticmethod
    def of(values: NDArray[Any]) -> "Stats":
        """The statistics of a column (T,) or (T, D)."""
        table = values.reshape(len(values), -1).astype(np.float64)
        return Stats(
            table.min(0), table.max(0), table.mean(0), table.std(0), np.array([len(table)])
        )

    @staticmethod
    def of_frames(frames: NDArray[np.uint8]) -> "Stats":
        """The statistics of each channel of frames (T, H, W, 3), scaled to [0, 1]."""
        counts = np.stack([np.bincount(frames[..., c].ravel(), minlength=256) for c in range(3)])
        levels = np.arange(256) / 255.0
        share = counts / counts.sum(1, keepdims=True)
        mean = share @ levels
        deviation = np.sqrt((share * (levels - mean[:, None]) ** 2).sum(1))
        present = [np.flatnonzero(row) / 255.0 for row in counts]
        low, high = np.array([row[0] for row in present]), np.array([row[-1] for row in present])
        shape = (3, 1, 1)
        return Stats(
            low.reshape(shape),
            high.reshape(shape),
            mean.reshape(shape),
            deviation.reshape(shape),
            np.array([len(frames)]),
        )

    def plain(self) -> dict[str, Any]:
        """The statistics as lists, for JSON and Parquet."""
        return {field.name: getattr(self, field.name).tolist() for field in fields(self)}


def merged(episodes: Sequence[dict[str, Stats]]) -> dict[str, Stats]:
    """The statistics of all episodes together."""
    return {name: _merge([episode[name] for episode in episodes]) for name in episodes[0]}


def _merge(parts: list[Stats]) -> Stats:
    counts = np.concatenate([part.count for part in parts])
    weights = (counts / counts.sum()).reshape(-1, *([1] * parts[0].mean.ndim))
    means = np.stack([part.mean for part in parts])
    mean = (weights * means).sum(0)
    squares = np.stack([part.std**2 for part in parts]) + (means - mean) ** 2
    return Stats(
        np.min([part.min for part in parts], axis=0),
        np.max([part.max for part in parts], axis=0),
        mean,
        np.sqrt((weights * squares).sum(0)),
        counts.sum(keepdims=True),
    )


def _robot_states(poses: NDArray[np.float64]) -> NDArray[np.float32]:
    """The robot's pose, and its fingers' angles relative to it: (T, 5)."""
    robot = poses[:, ROBOT]
    fingers = poses[:, FINGERS, 2] - robot[:, 2:]
    return np.concatenate([robot, fingers], axis=1).astype(np.float32)


def _arrow(column: NDArray[Any]) -> Any:
    if column.ndim == 1:
        return pa.array(column)
    return pa.FixedSizeListArray.from_arrays(pa.array(column.ravel()), column.shape[1])


def _task_table(tasks: list[str]) -> Any:
    """The tasks in the layout of a pandas data frame with them as index, which readers expect."""

    def column(name: str, pandas_type: str, numpy_type: str) -> dict[str, Any]:
        types = {"pandas_type": pandas_type, "numpy_type": numpy_type}
        return {"name": name, "field_name": name, "metadata": None, **types}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": range(len(tasks)), "task": tasks})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _flat(stats: Mapping[str, Stats]) -> dict[str, Any]:
    return {
        f"stats/{feature}/{name}": value
        for feature, one in stats.items()
        for name, value in one.plain().items()
    }


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=4) + "\n")
