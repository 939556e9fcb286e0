"""The wheel holds everything and works outside the tree; importing stays light."""

import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import magical

HEAVY = ("torch", "numba", "scipy", "pandas", "pymunk", "PIL", "matplotlib", "rich")


def run_python(*args: str, cwd: Path, path: Path | None = None) -> str:
    """The standard output of a fresh interpreter; `path` is searched before all else."""
    environment = {**os.environ, **({"PYTHONPATH": str(path)} if path else {})}
    done = subprocess.run(
        [sys.executable, *args],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def distributions(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the built wheel and source distribution; nothing is fetched."""
    folder = tmp_path_factory.mktemp("dist")
    run_python("-m", "build", "--no-isolation", "--outdir", str(folder), str(root), cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(distributions: Path) -> Path:
    """The built wheel."""
    (built,) = distributions.glob("magical_benchmark-*-py3-none-any.whl")
    return built


def files_of(source: Path) -> set[str]:
    """The files below a folder that a wheel holds."""
    skipped = {".pyc", ".nbi", ".nbc"}
    files = (path for path in source.rglob("*") if path.is_file() and path.suffix not in skipped)
    return {path.relative_to(source).as_posix() for path in files}


def test_wheel_holds_every_file_of_the_package(wheel: Path, root: Path) -> None:
    expected = files_of(root / "src")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (notice,) = (name for name in names if name.endswith("/NOTICE"))
        assert archive.read(notice).decode() == (root / "NOTICE").read_text()
        (metadata,) = (name for name in names if name.endswith("METADATA"))
        page = archive.read(metadata).decode()
    assert {"magical/py.typed", "magical/evaluation/data/published-scores.csv"} <= expected <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"magical", "magical_benchmark"}
    assert "\nCopyright 2020 Sam Toyer\n" in (root / "NOTICE").read_text()
    assert not re.findall(r"\]\((?!https?:)[^)]+\)", page)  # no link into the repository


@pytest.mark.parametrize("name", ["baselines", "goals", "play"])
def test_the_wheel_of_a_companion_holds_its_files_and_has_the_same_version(
    name: str, root: Path, tmp_path: Path
) -> None:
    if not (root / name).is_dir():
        pytest.skip("the source distribution has no companions")
    flags = ("--no-isolation", "--wheel", "--outdir", str(tmp_path))
    run_python("-m", "build", *flags, str(root / name), cwd=tmp_path)
    (built,) = tmp_path.glob(f"magical_{name}-{magical.__version__}-py3-none-any.whl")
    with zipfile.ZipFile(built) as archive:
        assert files_of(root / name / "src") <= set(archive.namelist())


def test_the_source_distribution_has_what_its_tests_need(distributions: Path, root: Path) -> None:
    (built,) = distributions.glob("magical_benchmark-*.tar.gz")
    with tarfile.open(built) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    needed = {"src", "tests", "docs", "examples", "benchmarks", "entries", "tools", "conftest.py"}
    assert needed <= {name.split("/")[0] for name in names}
    tests = {path.relative_to(root).as_posix() for path in (root / "tests").rglob("*.py")}
    assert tests <= names
    assert not [name for name in names if "results" in name.split("/")]


def test_installed_wheel_runs_an_environment(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    pip = ("-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-index")
    run_python(*pip, "--no-deps", "--target", str(site), str(wheel), cwd=tmp_path)
    script = """
import gymnasium, magical
env = gymnasium.make("magical/FindDupe-TestAll-v0", horizon=2, observation="state")
first, _ = env.reset(seed=1)
env.step(0)
second, _, _, truncated, info = env.step(1)
print(magical.__file__, bool((first != second).any()), truncated, sorted(info))
"""
    printed = run_python("-c", script, cwd=tmp_path, path=site).split(maxsplit=1)
    assert Path(printed[0]).is_relative_to(site)
    assert printed[1].startswith("True True ['eval_score'")
    version = run_python("-m", "magical", "--version", cwd=tmp_path, path=site)
    assert version.split()[0] == "magical"


@pytest.mark.parametrize("program", ["", "from magical.cli import main; main(['envs'])"])
def test_importing_and_listing_load_nothing_heavy(tmp_path: Path, program: str) -> None:
    script = f"import sys, magical\n{program}\nprint([m for m in {HEAVY} if m in sys.modules])"
    assert run_python("-c", script, cwd=tmp_path).splitlines()[-1] == "[]"
