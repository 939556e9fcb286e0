"""Random damage to a dataset's files raises `DatasetError` and nothing else."""

from pathlib import Path

from tests.demos.store.fuzz import fuzz_manifests, fuzz_trajectories


def test_mutants_of_a_trajectory_file_are_refused_or_can_be_used() -> None:
    outcomes = fuzz_trajectories(600, seed=1)
    assert outcomes["accepted and equal"] > 0
    assert outcomes["accepted, another trajectory"] > 0
    assert outcomes["refused"] > 300


def test_mutants_of_a_manifest_are_read_or_reported(tmp_path: Path) -> None:
    outcomes = fuzz_manifests(300, seed=1, folder=tmp_path / "dataset")
    assert outcomes["refused"] > 150
    assert outcomes["repaired"] > 0
