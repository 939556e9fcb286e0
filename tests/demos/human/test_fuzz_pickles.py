"""Random damage to a published file raises `UnsafeFileError` and nothing else."""

import io

import numpy as np

from magical.demos.human.safe_pickle import load
from tests.demos.human.fuzz_pickles import example, fuzz_pickles


def test_mutants_of_a_pickle_are_loaded_or_refused() -> None:
    assert load(io.BytesIO(example()), np.asarray)["env_name"] == "MoveToCorner-Demo-v0"
    outcomes = fuzz_pickles(1000, seed=1)
    assert outcomes.keys() == {"loaded", "refused"}
    assert outcomes["refused"] > 300
