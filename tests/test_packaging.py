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


def test_wheel_holds_every_file_of_the_package(wheel: Path, root: Path) -> None:
    source = root / "src"
    expected = {
        path.relative_to(source).as_posix()
        for path in (source / "magical").rglob("*")
        if path.is_file() and path.suffix not in {".pyc", ".nbi", ".nbc"}
    }
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert "magical/py.typed" in expected
    assert expected <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"magical", "magical_benchmark"}
    for needed in ("evaluation/data/published-scores.csv",):
        assert any(name.startswith(f"magical/{needed}") for name in names), needed
    assert not [name for name in names if "studies" in name or "scores.csv.gz" in name]


@pytest.mark.parametrize("name", ["baselines", "goals", "play"])
def test_the_wheel_of_a_companion_holds_its_files_and_has_the_same_version(
    name: str, root: Path, tmp_path: Path
) -> None:
    if not (root / name).is_dir():
        pytest.skip("the source distribution has no companions")
    flags = ("--no-isolation", "--wheel", "--outdir", str(tmp_path))
    run_python("-m", "build", *flags, str(root / name), cwd=tmp_path)
    (built,) = tmp_path.glob(f"magical_{name}-{magical.__version__}-py3-none-any.whl")
    source = root / name / "src"
    expected = {
        path.relative_to(source).as_posix()
        for path in source.rglob("*")
        if path.is_file() and path.suffix not in {".pyc", ".nbi", ".nbc"}
    }
    with zipfile.ZipFile(built) as archive:
        assert expected <= set(archive.namelist())


def test_the_source_distribution_has_what_its_tests_need(distributions: Path, root: Path) -> None:
    (built,) = distributions.glob("magical_benchmark-*.tar.gz")
    with tarfile.open(built) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    tops = {name.split("/")[0] for name in names}
    files = {*("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "Makefile", "NOTICE")}
    files |= {"conftest.py"}
    files |= {*("PKG-INFO", "README.md", "constraints.txt", "mkdocs.yml", "noxfile.py")}
    folders = {"benchmarks", "docs", "entries", "examples", "src", "tests", "tools"}
    assert tops - {".gitignore"} == {*files, *folders, "pyproject.toml"}
    tests = {path.relative_to(root).as_posix() for path in (root / "tests").rglob("*.py")}
    assert tests <= names
    assert not [name for name in names if "results" in name.split("/")]


def test_the_notice_has_the_published_packages_licence_and_is_in_the_wheel(
    wheel: Path, root: Path
) -> None:
    notice = (root / "NOTICE").read_text()
    assert "\nCopyright 2020 Sam Toyer\n" in notice
    assert "the above copyright notice and this permission notice appear in all copies." in notice
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("/NOTICE"))
        assert archive.read(name).decode() == notice


def test_the_package_page_has_no_link_into_the_repository(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("METADATA"))
        page = archive.read(name).decode()
    assert "## Ten lines" in page
    assert "Project-URL: Paper, https://" in page
    assert not re.findall(r"\]\((?!https?:)[^)]+\)", page)


def test_installed_wheel_runs_an_environment(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    pip = ("-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-index")
    run_python(*pip, "--no-deps", "--target", str(site), str(wheel), cwd=tmp_path)
    script = """
import gymnasium, magical
env = gymnasium.make("magical/FindDupe-TestAll-LoRes4E-v0", horizon=2)
first, _ = env.reset(seed=1)
env.step(0)
second, _, _, truncated, info = env.step(1)
print(magical.__file__, second.shape, bool((first != second).any()), truncated, sorted(info))
"""
    printed = run_python("-c", script, cwd=tmp_path, path=site).split(maxsplit=1)
    assert Path(printed[0]).is_relative_to(site)
    assert printed[1].startswith("(96, 96, 12) True True ['eval_score'")
    version = run_python("-m", "magical", "--version", cwd=tmp_path, path=site)
    assert version.split()[0] == "magical"


def test_importing_loads_nothing_heavy(tmp_path: Path) -> None:
    script = f"import sys, magical; print([m for m in {HEAVY} if m in sys.modules])"
    assert run_python("-c", script, cwd=tmp_path).strip() == "[]"


def test_command_line_loads_nothing_heavy(tmp_path: Path) -> None:
    script = (
        "import sys; from magical.cli import main; main(['envs']);"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    assert run_python("-c", script, cwd=tmp_path).splitlines()[-1] == "[]"
