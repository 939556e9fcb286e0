"""The budgets find the room, and the file, that is too long."""

from pathlib import Path

import pytest

from tools import budgets


@pytest.mark.parametrize(("lines", "complaints"), [(800, 0), (801, 1), (802, 2)])
def test_a_line_too_many(
    lines: int, complaints: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pyproject.toml").write_text(
        '[tool.budgets]\nroom = { files = ["src/*.py", "!src/left_out.py"], lines = 801 }\n'
    )
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "left_out.py").write_text("pass\n" * 900)
    (tmp_path / "src" / "x.py").write_text("pass\n" * lines)
    assert budgets.main(tmp_path, table=False) == (complaints > 0)
    assert len(capsys.readouterr().err.splitlines()) == complaints
