"""Random damage to a dataset's files raises `DatasetError` and nothing else."""

from pathlib import Path

from tests.demos.store.fuzz import fuzz_manifests, fuzz_trajectories


def test_mutants_of_a_trajectory_file_are_decoded_or_refused() -> None:
    outcomes = fuzz_trajectories(1000, seed=1)
    assert outcomes["decoded"] > 0
    assert outcomes["refused"] > 500


def test_mutants_of_a_manifest_are_read_or_reported(tmp_path: Path) -> None:
    outcomes = fuzz_manifests(500, seed=1, folder=tmp_path / "dataset")
    assert outcomes["refused"] > 250
    assert outcomes["repaired"] > 0
