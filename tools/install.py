"""Install this project in editable mode, with extras, into the environment that runs this file.

    python tools/install.py dev,report [OTHER ...]

OTHER are further distributions. All versions come from constraints.txt, including the build
backend's.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main(extras: str, *others: str) -> int:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install"]
    pip += ["--constraint", str(ROOT / "constraints.txt")]
    backend = subprocess.run([*pip, "hatchling", "hatch-fancy-pypi-readme"], check=False)
    if backend.returncode:
        return backend.returncode
    project = [*pip, "--no-build-isolation", "--editable", f"{ROOT}[{extras}]", *others]
    return subprocess.run(project, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
