"""Export to a LeRobotDataset v3.0: Parquet tables, a video for each camera, and metadata.

The layout follows the format's documentation and its reference writer: `meta/info.json`,
`meta/stats.json`, `meta/tasks.parquet`, `meta/episodes/`, `data/`, `videos/<camera>/`. Episodes are
concatenated into large files; `meta/episodes` has the position of each. Needs the `lerobot` extra.
LeRobot's own writer is not used: it would require LeRobot, PyTorch and a hundred other packages.
"""

import json
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

import magical
from magical.demos.export.video import Mp4Writer
from magical.demos.store.dataset import Dataset
from magical.demos.store.reader import Frames
from magical.demos.store.trajectory import VIEWS, Trajectory
from magical.envs.action_spec import Actions, ActionSpaceName
from magical.errors import DatasetError
from magical.scene.actions import PARTS
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE
from magical.scene.poses import FINGERS, ROBOT

VERSION = "v3.0"
FILES_PER_CHUNK = 1000
FRAMES_PER_FILE = 50_000  # after which new files are started
FPS = int(CONTROL_RATE)
CAMERAS = {view: f"observation.images.{view}" for view in VIEWS}
_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_STATE = ["robot_x", "robot_y", "robot_angle", "left_finger_angle", "right_finger_angle"]
_ACTION_NAMES = {"discrete": ["action"], "continuous": list(PARTS)}

# Chroma at full resolution: with the usual subsampling, outlines two pixels wide lose their colour.
PIXEL_FORMAT = "yuv444p"
OPTIONS = {"crf": "12", "g": "2", "bf": "0"}  # nearly lossless; a key frame every other frame
_CAMERA = {
    "dtype": "video",
    "shape": [FRAME_SIZE, FRAME_SIZE, 3],
    "names": ["height", "width", "channels"],
    "info": {
        "video.height": FRAME_SIZE,
        "video.width": FRAME_SIZE,
        "video.codec": "h264",
        "video.pix_fmt": PIXEL_FORMAT,
        "is_depth_map": False,
        "video.channels": 3,
        "has_audio": False,
        "video.fps": FPS,
    },
}

Columns = dict[str, NDArray[Any]]
Stats = dict[str, NDArray[Any]]  # min, max, mean, std: (D,), or (3, 1, 1) for cameras; count (1,)


def export_lerobot(
    dataset: Dataset,
    folder: Path | str,
    action_space: ActionSpaceName | None = None,
) -> int:
    """Write the dataset into a new folder; returns the number of frames, one for each action.

    Features: both cameras at 96 x 96 (H.264, slightly lossy), `action` (int64 from 0 to 17; if
    continuous, drive, turn and grip as float32 from -1 to 1), `next.done`, and, if all poses are
    known, `observation.state` (robot pose and finger angles).
    `action` is the one to imitate; if any trajectory has `expert_actions`, the executed actions are
    in `executed_action`. If any has `actors`, `is_demonstrated` is false in the steps to leave out.
    Scores, demonstrator and environment id are columns of `meta/episodes`.

    Args:
        dataset: the trajectories.
        folder: the folder to create.
        action_space: kind of the exported actions (default: continuous if any in the dataset are).

    Raises:
        TrajectoryError: discrete actions are requested, but some actions are not among the 18.
        DatasetError: the folder exists, the dataset is empty or a trajectory is damaged; no partial
            export remains.
    """
    folder = Path(folder)
    if folder.exists() or not len(dataset):
        found = f"{folder}, which exists" if len(dataset) else "no trajectories"
        raise DatasetError(f"export: expected trajectories and a new folder, found {found}")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".part-") as temporary:
        root = Path(temporary) / folder.name
        writer = _Writer(root, dataset, action_space)
        with writer.files:
            for trajectory in dataset:
                writer.add(trajectory)
        writer.finish()
        root.rename(folder)
    return writer.total


class _Writer:
    """An export: its open files (a table, and a video for each camera) and its metadata."""

    def __init__(self, root: Path, dataset: Dataset, action_space: ActionSpaceName | None) -> None:
        self.root = root
        self.total = 0
        self.files = ExitStack()
        self._has_states = all(entry.has_poses for entry in dataset.entries)
        self._has_labels = any(trajectory.expert_actions is not None for trajectory in dataset)
        self._has_actors = any(trajectory.actors is not None for trajectory in dataset)
        self._action_space = action_space or dataset.action_space()
        self._tasks: dict[str, int] = {}
        self._episodes: list[dict[str, Any]] = []
        self._columns: list[Columns] = []
        self._levels: dict[str, list[NDArray[np.int64]]] = {c: [] for c in CAMERAS.values()}
        self._file = -1

    def _start_files(self, schema: Any) -> None:
        """Close the open files and start the next ones."""
        self.files.close()
        self._file += 1
        self._frames_in_file = 0
        path = self._path("data", "parquet")
        self._table = self.files.enter_context(pq.ParquetWriter(path, schema))
        self._videos = {
            view: self.files.enter_context(
                Mp4Writer(self._path(f"videos/{camera}", "mp4"), FPS, PIXEL_FORMAT, OPTIONS)
            )
            for view, camera in CAMERAS.items()
        }

    def add(self, trajectory: Trajectory) -> None:
        """Write one episode: the frame before each action, and the action."""
        trajectory = trajectory.with_action_space(self._action_space)
        steps = len(trajectory)
        words = trajectory.task.instruction(trajectory.scene)
        columns = self._episode_columns(trajectory, self._tasks.setdefault(words, len(self._tasks)))
        table = pa.table({name: _arrow(column) for name, column in columns.items()})
        if self.total == 0 or self._frames_in_file >= FRAMES_PER_FILE:
            self._start_files(table.schema)
        self._table.write_table(table)
        for view, video in self._videos.items():
            frames = Frames(trajectory, view, FRAME_SIZE).take(np.arange(steps))
            for frame in frames:
                video.write(frame)
            self._levels[CAMERAS[view]].append(_levels(frames))
        self._columns.append(columns)
        self._episodes.append(self._episode(trajectory, words))
        self.total += steps
        self._frames_in_file += steps

    def finish(self) -> None:
        """Write the metadata of the closed files."""
        meta = self.root / "meta"
        path = meta / "episodes" / f"{_FILE.format(chunk_index=0, file_index=0)}.parquet"
        path.parent.mkdir(parents=True)
        episodes = range(len(self._episodes))
        rows = [self._episodes[i] | _flat(self._stats(slice(i, i + 1))) for i in episodes]
        pq.write_table(pa.Table.from_pylist(rows), path)
        pq.write_table(_task_table(list(self._tasks)), meta / "tasks.parquet")
        plain = {
            feature: {name: value.tolist() for name, value in stats.items()}
            for feature, stats in self._stats(slice(None)).items()
        }
        for name, content in (("stats", plain), ("info", self._info())):
            (meta / f"{name}.json").write_text(json.dumps(content, indent=4) + "\n")

    def _stats(self, episodes: slice) -> dict[str, Stats]:
        """The statistics of each feature over a range of episodes."""
        parts = self._columns[episodes]
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        frames = {camera: sum(levels[episodes]) for camera, levels in self._levels.items()}
        return {
            **{name: _column_stats(column) for name, column in columns.items()},
            **{camera: _frame_stats(np.asarray(levels)) for camera, levels in frames.items()},
        }

    def _episode_columns(self, trajectory: Trajectory, task: int) -> Columns:
        steps = len(trajectory)
        frame = np.arange(steps)
        columns: Columns = {}
        if self._has_states and trajectory.poses is not None:
            columns["observation.state"] = _robot_states(trajectory.poses[:-1])
        columns |= {"action": _exported(trajectory.labels), "next.done": frame == steps - 1}
        if self._has_labels:
            columns["executed_action"] = _exported(trajectory.actions)
        if self._has_actors:
            columns["is_demonstrated"] = trajectory.is_demonstrated
        return columns | {
            "timestamp": (frame / FPS).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(steps, len(self._episodes)),
            "index": self.total + frame,
            "task_index": np.full(steps, task),
        }

    def _episode(self, trajectory: Trajectory, words: str) -> dict[str, Any]:
        steps, start = len(trajectory), self._frames_in_file
        chunk, file = divmod(self._file, FILES_PER_CHUNK)
        row: dict[str, Any] = {
            "episode_index": len(self._episodes),
            "tasks": [words],
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
            "demonstrator": trajectory.demonstrator,
        }
        for camera in CAMERAS.values():
            row[f"videos/{camera}/chunk_index"] = chunk
            row[f"videos/{camera}/file_index"] = file
            row[f"videos/{camera}/from_timestamp"] = start / FPS
            row[f"videos/{camera}/to_timestamp"] = (start + steps) / FPS
        return row

    def _info(self) -> dict[str, Any]:
        names = {"observation.state": _STATE, "action": _ACTION_NAMES[self._action_space]}
        features = {
            name: {
                "dtype": column.dtype.name,
                "shape": list(column.shape[1:]) or [1],
                "names": names.get(name),
            }
            for name, column in self._columns[0].items()
        }
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
            "features": {**dict.fromkeys(CAMERAS.values(), _CAMERA), **features},
            "exported_by": f"magical {magical.__version__}",
        }

    def _path(self, folder: str, suffix: str) -> Path:
        chunk, file = divmod(self._file, FILES_PER_CHUNK)
        name = _FILE.format(chunk_index=chunk, file_index=file)
        path = self.root / folder / f"{name}.{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def _levels(frames: NDArray[np.uint8]) -> NDArray[np.int64]:
    """How often each of the 256 levels occurs in each channel of frames (T, H, W, 3): (3, 256)."""
    return np.stack([np.bincount(frames[..., c].ravel(), minlength=256) for c in range(3)])


def _frame_stats(counts: NDArray[np.int64]) -> Stats:
    """The statistics of frames, scaled to [0, 1], from the counts of their levels (3, 256)."""
    levels = np.arange(256) / 255.0
    share = counts / counts.sum(1, keepdims=True)
    mean = share @ levels
    present = [levels[row > 0] for row in counts]
    stats = {
        "min": np.array([row[0] for row in present]),
        "max": np.array([row[-1] for row in present]),
        "mean": mean,
        "std": np.sqrt((share * (levels - mean[:, None]) ** 2).sum(1)),
    }
    count = counts[:1].sum(1) // FRAME_SIZE**2
    return {**{name: value.reshape(3, 1, 1) for name, value in stats.items()}, "count": count}


def _column_stats(column: NDArray[Any]) -> Stats:
    """The statistics of a column (N,) or (N, D)."""
    table = column.reshape(len(column), -1).astype(np.float64)
    stats = {name: getattr(table, name)(axis=0) for name in ("min", "max", "mean", "std")}
    return {**stats, "count": np.array([len(table)])}


def _exported(actions: Actions) -> NDArray[Any]:
    """Continuous actions as float32, which LeRobot's policies expect; others unchanged."""
    return actions.astype(np.float32) if actions.dtype.kind == "f" else actions


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
    """The tasks in the layout of a pandas data frame indexed by task, which readers expect."""

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


def _flat(stats: dict[str, Stats]) -> dict[str, Any]:
    return {
        f"stats/{feature}/{name}": value.tolist()
        for feature, one in stats.items()
        for name, value in one.items()
    }
