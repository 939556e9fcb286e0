"""Progress on standard error."""

import pytest

from magical import progress


def test_without_a_terminal_there_are_lines_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress.ProgressBar("rollouts", 3) as bar:
        bar.advance(1)  # too soon
        monkeypatch.setattr(progress, "LINE_INTERVAL", -1.0)
        bar.advance(2)
    with progress.ProgressBar("bc", 2) as bar:
        bar.update(1, {"loss": 0.25})
    assert capsys.readouterr().err == "rollouts 3/3\nbc 1/2  loss 0.25\n"
