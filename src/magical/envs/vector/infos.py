"""The `infos` of a vector environment, as Gymnasium's own would build them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs.vector.buffers import VectorBuffers
from magical.observe.arrays import copy_arrays, select

SCORE_KEYS = ("eval_score", "published_code_score")

Infos = dict[str, Any]


def score_infos(scores: NDArray[np.float64], mask: NDArray[np.bool_]) -> Infos:
    """Scores (2, N) under their names, each with its mask (N,)."""
    infos: Infos = {}
    for key, values in zip(SCORE_KEYS, scores, strict=True):
        infos[key] = values
        infos[f"_{key}"] = mask.copy()
    return infos


def same_step_infos(
    buffers: VectorBuffers, mask: NDArray[np.bool_], ended: NDArray[np.bool_]
) -> Infos:
    """The infos of SAME_STEP autoreset when some sub-environments have ended and been reset.

    `final_obs` is an object array (N,) of observations, `final_info` holds the final scores.
    """
    observations = np.full(len(ended), None, dtype=object)
    for row in np.flatnonzero(ended).tolist():
        observations[row] = copy_arrays(select(buffers.final_observations, row))
    return {
        **score_infos(np.zeros_like(buffers.scores), mask),
        "final_obs": observations,
        "_final_obs": ended.copy(),
        "final_info": score_infos(np.where(ended, buffers.scores, 0.0), ended),
        "_final_info": ended.copy(),
    }
