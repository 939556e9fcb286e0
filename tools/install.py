"""Install this project in editable mode, with extras, into the environment that runs this file.

    python tools/install.py dev,report [OTHER ...]

OTHER are the project's other distributions by their folders, with extras, such as `baselines` or
`goals[learners]`, which are installed in editable mode as well, or any further distributions. All
versions come from constraints.txt, including the build backend's.
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
    wanted = ["--no-build-isolation", "--editable", f"{ROOT}[{extras}]"]
    for other in others:
        ours = (ROOT / other.partition("[")[0] / "pyproject.toml").is_file()
        wanted += ["--editable", str(ROOT / other)] if ours else [other]
    return subprocess.run([*pip, *wanted], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
