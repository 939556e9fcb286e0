"""Export to Minari: one dataset for each environment, with lossless frames.

Needs the `minari` extra.
"""

import os
import re
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import magical
from magical.demos.store.dataset import Dataset
from magical.demos.store.reader import observations
from magical.demos.store.trajectory import Trajectory
from magical.envs import EnvId, env_spec
from magical.envs.action_spec import DISCRETE, ActionSpaceName, ActionSpec, action_spec
from magical.errors import DatasetError, UnknownNameError
from magical.extras import require
from magical.observe import PRESETS

require("minari")

import minari  # noqa: E402
from minari.data_collector.episode_buffer import EpisodeBuffer  # noqa: E402
from minari.namespace import create_namespace, list_local_namespaces  # noqa: E402
from minari.storage import get_dataset_path  # noqa: E402

_ROOT = "MINARI_DATASETS_PATH"


def export_minari(
    dataset: Dataset,
    name: str = "demos",
    preset: str = "LoRes4E",
    root: Path | None = None,
    action_space: ActionSpaceName | None = None,
) -> list[str]:
    """Write Minari datasets `magical/<Task>-<Variant>-<preset>/<name>-v0`; returns their ids.

    Observations are the preset's, as the environment returned them, in HDF5 with
    `jpeg_encoding=False`. Actions are the executed ones. If a trajectory has `expert_actions`, the
    info of observation t has the one of step t as `expert_action`, and the last info -1, or NaN for
    continuous actions; if it has `actors`, the infos have `is_demonstrated`.
    Rewards are 0; an episode's last info has the known scores, and its metadata the demonstrator.
    `root` is Minari's dataset folder (default: Minari's own). `action_space` is the kind of the
    exported actions (default: for each environment, continuous if any of its actions are).

    Raises:
        UnknownNameError: there is no such preset or action space.
        DatasetError: the name is invalid, a dataset of that name exists, the dataset is empty or a
            trajectory is damaged; nothing is written then.
        TrajectoryError: a recording of frames lacks those of the preset, or discrete actions are
            requested, but some actions are not among the 18.
    """
    if preset not in PRESETS:
        raise UnknownNameError(f"preset: expected one of {', '.join(PRESETS)}, found {preset!r}")
    if not len(dataset):
        raise DatasetError("export: expected trajectories, found none")
    if not re.fullmatch(r"[\w-]+", name):
        raise DatasetError(f"name: expected letters, digits, - and _, found {name!r}")
    env_ids = list(dict.fromkeys(entry.env_id for entry in dataset.entries))
    made = [f"magical/{each.task}-{each.variant}-{preset}/{name}-v0" for each in env_ids]
    with _moved_when_complete(made, root):
        for env_id, minari_id in zip(env_ids, made, strict=True):
            part = dataset.filter(env_id=env_id)
            actions = action_spec(action_space or part.action_space())
            with_preset = EnvId(env_id.task, env_id.variant, preset)
            _create(minari_id, _spec(with_preset, part, actions), part, preset, actions)
    return made


def _spec(env_id: EnvId, part: Dataset, actions: ActionSpec) -> Any:
    """The environment's specification, with the episodes' length as its horizon if all share it."""
    spec = replace(env_spec(env_id), additional_wrappers=())  # which `make_vec` does not take
    if actions is not DISCRETE:
        spec.kwargs["action_space"] = actions.name
    lengths = {entry.length for entry in part.entries}
    if len(lengths) == 1 and lengths != {env_id.task_spec.horizon}:
        spec.kwargs["horizon"] = lengths.pop()
    return spec


def _create(minari_id: str, spec: Any, part: Dataset, preset: str, actions: ActionSpec) -> None:
    with warnings.catch_warnings():
        # Minari warns about each missing author and link; adding them is up to the dataset's owner.
        warnings.filterwarnings(
            "ignore", message=r"`(author|author_email|code_permalink|eval_env)` is set"
        )
        created = minari.create_dataset_from_buffers(
            minari_id,
            buffer=_buffers(part, preset, actions),  # a generator: one episode in memory at a time
            env=spec,
            observation_space=PRESETS[preset].space,
            action_space=actions.space,
            jpeg_encoding=False,
            data_format="hdf5",
            algorithm_name=", ".join(sorted({entry.demonstrator for entry in part.entries})),
            description=f"MAGICAL demonstrations, exported by magical {magical.__version__}",
            requirements=[f"magical-benchmark>={magical.__version__}"],
        )
    created.storage.update_episode_metadata(
        [
            {
                "demonstrator": entry.demonstrator,
                "published_code_score": entry.published_code_score,
                **({} if entry.score is None else {"score": entry.score}),
            }
            for entry in part.entries
        ]
    )


def _buffers(part: Dataset, preset: str, actions: ActionSpec) -> Iterator[Any]:
    for index, stored in enumerate(part):
        trajectory = stored.with_action_space(actions.name)
        steps = len(trajectory)
        yield EpisodeBuffer(
            id=index,
            seed=trajectory.seed if (trajectory.seed or 0) < 1 << 63 else None,  # HDF5: int64
            observations=observations(trajectory, preset),
            actions=trajectory.actions.astype(actions.space.dtype),
            rewards=[0.0] * steps,
            terminations=[False] * steps,
            truncations=[False] * (steps - 1) + [True],
            infos=_infos(trajectory),
        )


def _infos(trajectory: Trajectory) -> dict[str, Any]:
    """The scores as in the environment's `info`, 0.0 before the last step; and the labels."""
    scores = {"published_code_score": trajectory.published_code_score}
    if trajectory.score is not None:
        scores["eval_score"] = trajectory.score
    infos = {name: np.append(np.zeros(len(trajectory)), score) for name, score in scores.items()}
    if trajectory.expert_actions is not None:
        spec = action_spec(trajectory.action_space)
        none = np.full((1, *spec.shape), spec.nothing, spec.dtype)
        infos["expert_action"] = np.concatenate([trajectory.expert_actions, none])
    if trajectory.actors is not None:
        infos["is_demonstrated"] = np.append(trajectory.is_demonstrated, False)
    return infos


@contextmanager
def _moved_when_complete(minari_ids: list[str], root: Path | None) -> Iterator[None]:
    """Let Minari write to a temporary folder, then move the complete datasets to their targets."""
    with _minari_root(root):
        # Minari would nest a relative path inside itself.
        home = Path(get_dataset_path()).resolve()
        for target in (home / minari_id for minari_id in minari_ids):
            if target.exists():
                raise DatasetError(f"{target}: a dataset of that name exists; choose another")
        with tempfile.TemporaryDirectory(dir=home, prefix=".part-") as folder:
            with _minari_root(Path(folder)):
                yield
            for minari_id in minari_ids:
                (home / minari_id).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / minari_id).rename(home / minari_id)
        for namespace in (minari_id.rpartition("/")[0] for minari_id in minari_ids):
            if namespace not in list_local_namespaces():
                create_namespace(namespace)


@contextmanager
def _minari_root(root: Path | None) -> Iterator[None]:
    """Set Minari's dataset folder, through an environment variable that it reads at every call."""
    before = os.environ.get(_ROOT)
    if root is not None:
        os.environ[_ROOT] = str(root)
    try:
        yield
    finally:
        os.environ.pop(_ROOT, None)
        if before is not None:
            os.environ[_ROOT] = before
