"""`studies/demonstrations/human_fidelity.py`, on a small dataset."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from magical.demos import DatasetWriter
from tests.demos.conftest import MakeTrajectory

RECOVERY = {
    "wrong_pixels": [0.0, 1e-4],
    "deviations": {
        name: {"position": 1e-5, "angle": 1e-4} for name in ("robot", "fingers", "eyes", "blocks")
    },
}


def run(root: Path, dataset: Path) -> tuple[int, str]:
    command = [
        sys.executable,
        str(root / "studies" / "demonstrations" / "human_fidelity.py"),
        str(dataset),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    return done.returncode, done.stdout + done.stderr


def test_a_recording_of_the_simulation_is_predicted(
    root: Path, tmp_path: Path, make_trajectory: MakeTrajectory
) -> None:
    writer, made = DatasetWriter(tmp_path / "data"), make_trajectory(steps=12)
    writer.append(made)
    status, output = run(root, tmp_path / "data")
    assert (status, "no trajectories with recovered poses" in output) == (1, True)
    metadata = {"source": "a", "recorded_score": 0.5, "recovery": RECOVERY}
    writer.append(replace(made, metadata=metadata))
    status, output = run(root, tmp_path / "data")
    assert status == 0, output
    cells = [line.strip("| ").split(" | ") for line in output.splitlines()]
    (recovery,) = (row for row in cells if row[0] == "MoveToCorner")
    assert recovery[1:4] == ["1", "0.0050%", "0.0100%"]
    assert ["a", "0.5", "0.0", "0.0"] in cells
    (driving,) = (row for row in cells if row[:2] == ["driving", "8"] and "position" in row[3])
    assert driving[2] == "5"
    assert float(driving[4]) < 1.0
