"""The architectures that studies compare."""

from pathlib import Path

import pytest

from magical_baselines.networks import find_network
from studies.learners.networks import CANDIDATES


def test_every_candidate_network_is_found(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(root / "studies" / "learners"))
    assert CANDIDATES
    for name, network in CANDIDATES.items():
        assert find_network(network).HIDDEN, name
