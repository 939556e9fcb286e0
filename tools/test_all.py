"""Run the tests on Python 3.11, 3.12 and 3.13, each in its own environment `.venv-<version>`.

    python tools/test_all.py [VERSION ...]

PyTorch is left out: `make test` runs what needs it, this shows that nothing else does. A version
without an interpreter on this machine is named and skipped; the exit status is 1 if the tests fail
on any version, or if no interpreter is found.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.11", "3.12", "3.13")
EXTRAS = "dev,report,video,window,minari,lerobot,web"


def candidates(version: str) -> Iterator[str]:
    """Commands and paths that may be this version's interpreter, pyenv's included."""
    yield from filter(None, [shutil.which(f"python{version}")])
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    yield from (str(path) for path in sorted(pyenv.glob(f"{version}.*/bin/python{version}")))


def find(version: str) -> str | None:
    """The first candidate that runs and is of this version."""
    script = "import sys; print('%d.%d' % sys.version_info[:2])"
    for command in candidates(version):
        found = subprocess.run([command, "-c", script], capture_output=True, text=True, check=False)
        if found.stdout.strip() == version:
            return command
    return None


def set_up(interpreter: str, environment: Path) -> bool:
    """Create the environment; done again when pyproject.toml or constraints.txt are newer."""
    ready = environment / ".ready"
    sources = [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    if ready.exists() and ready.stat().st_mtime > max(s.stat().st_mtime for s in sources):
        return True
    python = environment / "bin" / "python"
    steps = [] if python.exists() else [[interpreter, "-m", "venv", str(environment)]]
    steps.append([str(python), str(ROOT / "tools" / "install.py"), EXTRAS])
    if any(subprocess.run(step, check=False).returncode for step in steps):
        return False
    ready.touch()
    return True


def run(version: str) -> str:
    """Test one version and say how it went."""
    interpreter = find(version)
    if interpreter is None:
        return "skipped: no interpreter found"
    environment = ROOT / f".venv-{version}"
    print(f"== Python {version} ({interpreter})", flush=True)
    if not set_up(interpreter, environment):
        return "failed: set-up"
    command = [str(environment / "bin" / "python"), "-m", "pytest", "-q", "-rs", "-n", "auto"]
    command += ["--dist", "loadfile"]
    return "failed" if subprocess.run(command, cwd=ROOT, check=False).returncode else "passed"


def main(versions: Sequence[str]) -> int:
    """Run the versions and print a summary."""
    results = {version: run(version) for version in versions}
    for version, result in results.items():
        print(f"Python {version}: {result}")
    failed = any(result.startswith("failed") for result in results.values())
    return 1 if failed or "passed" not in results.values() else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or VERSIONS))
