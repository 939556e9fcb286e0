"""Signals during training."""

import signal

import pytest

from magical_baselines.running.interrupts import Interrupts


def test_a_handler_that_is_not_pythons_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(signal, "getsignal", lambda _: None)  # as in R or Julia
    with Interrupts():
        monkeypatch.undo()
        assert signal.getsignal(signal.SIGTERM) is before
