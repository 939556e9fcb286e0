"""Drives to whatever is colourful: the policy of `examples/third_party_policy.py`."""

import runpy
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "third_party_policy.py"
SeekColour = runpy.run_path(str(EXAMPLE))["SeekColour"]
