"""The `infos` of a vector environment, as Gymnasium's own would build them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs.block import Block, copy_of, row_of

SCORE_KEYS = ("eval_score", "published_code_score")

Infos = dict[str, Any]


def score_infos(scores: NDArray[np.float64], mask: NDArray[np.bool_]) -> Infos:
    """Scores (2, N) under their names, each with its mask (N,)."""
    infos: Infos = {}
    for key, values in zip(SCORE_KEYS, scores, strict=True):
        infos[key] = values
        infos[f"_{key}"] = mask.copy()
    return infos


def same_step_infos(block: Block, mask: NDArray[np.bool_], ended: NDArray[np.bool_]) -> Infos:
    """What SAME_STEP autoreset tells when some worlds have ended and already begun anew.

    `final_obs` is an object array (N,) of observations, `final_info` holds the final scores.
    """
    observations = np.full(len(ended), None, dtype=object)
    for row in np.flatnonzero(ended).tolist():
        observations[row] = copy_of(row_of(block.final_observations, row))
    return {
        **score_infos(np.zeros_like(block.scores), mask),
        "final_obs": observations,
        "_final_obs": ended.copy(),
        "final_info": score_infos(np.where(ended, block.scores, 0.0), ended),
        "_final_info": ended.copy(),
    }
