"""Run folders, their metrics and plans as plain files; what entries state about their making.

A reader of a run needs neither PyTorch nor the code that made it.
"""

from magical.runs.folder import is_run, read_json
from magical.runs.machine import provenance, versions
from magical.runs.metrics import read_metrics

__all__ = ["is_run", "provenance", "read_json", "read_metrics", "versions"]
