"""Demonstrations elsewhere: videos, Minari, the Hugging Face Hub; each needs the extra it names."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
from numpy.typing import NDArray
from PIL import ImageDraw, ImageFont

from magical import __version__
from magical.demos.dataset import SUFFIX, Dataset
from magical.demos.trajectory import VIEWS, Frames, Trajectory, observations
from magical.envs import EnvId, env_spec
from magical.envs.action_spec import ActionSpec, action_spec
from magical.errors import DatasetError
from magical.extras import require
from magical.files import write_atomically
from magical.messages import printable
from magical.observe import PRESETS
from magical.scene import Poses
from magical.scene.constants import CONTROL_RATE, FRAME_SIZE, RAW_FRAME_SIZE

BANNER = 32  # pixels high, above the frames of a video
LAST_FRAME_REPEATS = 12  # of the final frame of a demonstration


def write_video(trajectories: Iterable[Trajectory], path: Path | str) -> int:
    """Write an MP4 of all trajectories (extra `video`); returns its number of frames."""
    require("video")
    import av

    count = 0
    with write_atomically(path) as file, av.open(file, "w", format="mp4") as container:
        stream: Any = container.add_stream("libx264", Fraction(CONTROL_RATE), {"qp": "10"})
        stream.height, stream.width = BANNER + RAW_FRAME_SIZE, RAW_FRAME_SIZE * len(VIEWS)
        for frame in (frame for trajectory in trajectories for frame in video_frames(trajectory)):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            count += 1
        container.mux(stream.encode())
    return count


def video_frames(trajectory: Trajectory) -> Iterator[NDArray[np.uint8]]:
    """Both views side by side, (BANNER + 384, 768, 3) uint8, with the score if poses are known."""
    poses, last, side = trajectory.poses, len(trajectory), RAW_FRAME_SIZE
    size = FRAME_SIZE if poses is None else side
    shown = (trajectory.frames or {}) if poses is None else VIEWS
    sources = [Frames(trajectory, view, size) for view in VIEWS if view in shown]
    for time in [*range(last + 1), *[last] * LAST_FRAME_REPEATS]:
        score = f"{trajectory.published_code_score:.2f}" if time == last else "..."
        if poses is not None:
            score = f"{trajectory.task.score(trajectory.scene, Poses(poses[time])):.2f}"
        image = PIL.Image.new("RGB", (side * len(VIEWS), BANNER + side), "white")
        for i, source in enumerate(sources):
            view = PIL.Image.fromarray(source.take([time])[0])
            view = view.resize((side, side), PIL.Image.Resampling.NEAREST)
            image.paste(view, (i * side, BANNER))
        by = f"{trajectory.env_id}, {printable(trajectory.demonstrator, 40)}"
        text = f"{by}, step {time}/{last}, score {score}"
        ImageDraw.Draw(image).text((8, 6), text, (60, 60, 70), ImageFont.load_default(16))
        yield np.asarray(image)


def export_minari(dataset: Dataset, name: str = "demos", preset: str = "LoRes4E") -> list[str]:
    """Write Minari datasets `magical/<Task>-<Variant>-<preset>/<name>-v0` (extra `minari`).

    Observations are the preset's, without loss; actions the executed ones; rewards 0. The info of
    observation t has the action to imitate in step t as `expert_action`, if there are others than
    the executed ones, and `is_demonstrated`, if a policy acted in some steps; the last info has the
    known scores. Returns the datasets' ids, one for each environment.
    """
    require("minari")
    import minari

    made = []
    for env_id in dict.fromkeys(entry.env_id for entry in dataset.entries):
        part = dataset.filter(env_id=env_id)
        actions = action_spec(part.action_space())
        spec = replace(env_spec(EnvId(env_id.task, env_id.variant, preset)), additional_wrappers=())
        spec.kwargs["action_space"] = actions.name
        if len(lengths := {entry.length for entry in part.entries}) == 1:
            spec.kwargs["horizon"] = lengths.pop()
        made.append(f"magical/{env_id.task}-{env_id.variant}-{preset}/{name}-v0")
        try:
            minari.create_dataset_from_buffers(
                made[-1],
                buffer=_buffers(part, preset, actions),  # one episode in memory at a time
                env=spec,
                eval_env=spec,
                observation_space=PRESETS[preset].space,
                action_space=actions.space,
                jpeg_encoding=False,
                data_format="hdf5",
                algorithm_name=", ".join(sorted({e.demonstrator for e in part.entries})),
                description=f"MAGICAL demonstrations, exported by magical {__version__}",
                requirements=[f"magical-benchmark>={__version__}"],
                **dict.fromkeys(("author", "author_email", "code_permalink"), "unknown"),
            )
        except (AssertionError, OSError, ValueError) as error:
            raise DatasetError(f"{made[-1]}: Minari refuses: {error}") from error
    return made


def _buffers(part: Dataset, preset: str, actions: ActionSpec) -> Iterator[Any]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    for index, stored in enumerate(part):
        trajectory, steps = stored.with_action_space(actions.name), len(stored)
        before = np.zeros(steps)  # scores before the last step, as in the environment's info
        infos = {"published_code_score": np.append(before, trajectory.published_code_score)}
        if trajectory.score is not None:
            infos["eval_score"] = np.append(before, trajectory.score)
        if trajectory.expert_actions is not None:
            none = np.full((1, *actions.shape), actions.nothing, actions.dtype)
            infos["expert_action"] = np.concatenate([trajectory.expert_actions, none])
        if trajectory.actors is not None:
            infos["is_demonstrated"] = np.append(trajectory.is_demonstrated, False)
        yield EpisodeBuffer(
            id=index,
            seed=trajectory.seed,
            observations=observations(trajectory, preset),
            actions=trajectory.actions.astype(actions.space.dtype),
            rewards=[0.0] * steps,
            terminations=[False] * steps,
            truncations=[False] * (steps - 1) + [True],
            infos=infos,
        )


def push(dataset: Dataset, repo: str, licence: str, *, private: bool = False) -> str:
    """Upload a dataset to the Hub, in place of an earlier one (extra `hub`).

    The repository `OWNER/NAME` is created if it does not exist, then private if that is asked for;
    `licence` is an identifier of the Hub, such as `cc-by-4.0`. Returns the repository's address.
    Raises `DatasetError` for published human demonstrations, which carry no licence, for an empty
    dataset, and if the Hub refuses the upload or cannot be reached.
    """
    require("hub")
    from huggingface_hub import HfApi

    entries = dataset.entries
    human = [entry.name for entry in entries if "source_sha256" in entry.metadata]
    if human or not entries:
        found = f"published ones without a licence, such as {human[0]}" if human else "none"
        raise DatasetError(f"{dataset.path}: expected demonstrations, found {printable(found)}")
    counts = Counter((entry.env_id, entry.demonstrator) for entry in entries)
    rows = [f"- {n} of {env_id} by {printable(by)}" for (env_id, by), n in sorted(counts.items())]
    card = (
        f"---\nlicense: {licence}\ntags: [magical-benchmark, imitation-learning]\n---\n"
        "# Demonstrations for the MAGICAL benchmark\n\n" + "\n".join(rows) + "\n\n"
        f'    pip install "magical-benchmark[hub]"\n    magical demos pull {repo} --out demos\n'
    )
    with _hub_errors(repo):
        api: Any = HfApi()
        where = {"repo_id": repo, "repo_type": "dataset"}
        address = api.create_repo(**where, private=private, exist_ok=True)
        chosen = {"allow_patterns": [e.file for e in entries], "delete_patterns": [f"*{SUFFIX}"]}
        api.upload_folder(**where, folder_path=dataset.path, **chosen)
        api.upload_file(**where, path_or_fileobj=card.encode(), path_in_repo="README.md")
    return str(address)


def pull(repo: str, out: Path | str, revision: str | None = None) -> Dataset:
    """Download a dataset into a new folder, and read all of it; raises as `push`."""
    require("hub")
    from huggingface_hub import snapshot_download

    if Path(out).exists():
        raise DatasetError(f"{out}: expected a new folder, found one that exists; choose another")
    with _hub_errors(repo):
        where: Any = {"repo_type": "dataset", "revision": revision, "local_dir": out}
        snapshot_download(repo, **where, allow_patterns=[f"*{SUFFIX}"])
    dataset = Dataset.open(out)
    for _ in dataset:  # each file is read and checked
        pass
    return dataset


@contextmanager
def _hub_errors(repo: str) -> Iterator[None]:
    """Turn errors of the Hub's client into a `DatasetError` that names the repository."""
    from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]  # httpx's

    try:
        yield
    except (HTTPError, OSError, RuntimeError, ValueError) as error:
        what = printable(str(error).strip().partition("\n")[0])
        raise DatasetError(f"{printable(repo)} on the Hub: {what}") from error
