"""The budgets find the room, and the file, that is too long."""

import subprocess
import sys
from pathlib import Path


def test_a_line_too_many(root: Path, tmp_path: Path) -> None:
    (tmp_path / "tools").mkdir()
    tool = tmp_path / "tools" / "budgets.py"
    tool.write_text((root / "tools" / "budgets.py").read_text())
    (tmp_path / "pyproject.toml").write_text(
        '[tool.budgets]\nroom = { files = ["src/**/*.py", "!src/left_out.py"], lines = 801 }\n'
    )
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "left_out.py").write_text("pass\n" * 900)
    room = tmp_path / "src" / "x.py"
    for lines, complaints in [(800, 0), (801, 1), (802, 2)]:
        room.write_text("pass\n" * lines)
        ran = subprocess.run([sys.executable, tool], capture_output=True, text=True, check=False)
        assert ran.returncode == (complaints > 0)
        assert len(ran.stderr.splitlines()) == complaints
