"""The infos of a vector environment, as Gymnasium's own build them: arrays with their masks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs.env import SCORE_KEYS
from magical.envs.ids import EnvId
from magical.scene import Scene
from magical.tasks.programs import SUCCESS

Bools = NDArray[np.bool_]
Infos = dict[str, Any]


def score_infos(scores: NDArray[np.float64], mask: Bools) -> Infos:
    """Scores (2, N) and success under their names, each with its mask (N,)."""
    values = dict(zip(SCORE_KEYS, scores, strict=True)) | {"is_success": scores[0] > SUCCESS}
    return values | {f"_{key}": mask.copy() for key in values}


def instruction_infos(
    started: Sequence[tuple[int, Scene]],
    env_ids: Sequence[EnvId],
    paraphrase: int,
    attributes: bool,
) -> Infos:
    """The instructions of the sub-environments that have started an episode, by their scenes."""
    if not started:
        return {}
    words, mask = np.full(len(env_ids), None, dtype=object), np.zeros(len(env_ids), np.bool_)
    for row, scene in started:
        task, mask[row] = env_ids[row].task_spec, True
        words[row] = task.instruction(scene, paraphrase=paraphrase, attributes=attributes)
    return {"instruction": words, "_instruction": mask}
