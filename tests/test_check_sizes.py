"""The length check finds what is too long."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def check_sizes(root: Path) -> ModuleType:
    """The tool as a module."""
    spec = importlib.util.spec_from_file_location("check_sizes", root / "tools" / "check_sizes.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("lines", "status"), [(400, 0), (401, 1)])
def test_files(check_sizes: ModuleType, tmp_path: Path, lines: int, status: int) -> None:
    (tmp_path / "x.py").write_text("pass\n" * lines)
    assert check_sizes.main([str(tmp_path)]) == status


@pytest.mark.parametrize(("lines", "status"), [(50, 0), (51, 1)])
def test_functions(check_sizes: ModuleType, tmp_path: Path, lines: int, status: int) -> None:
    body = "        pass\n" * (lines - 1)
    (tmp_path / "x.py").write_text(f"class A:\n    def f(self):\n{body}")
    assert check_sizes.main([str(tmp_path)]) == status
