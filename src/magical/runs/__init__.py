"""Run folders and their metrics as plain files.

This subpackage is below `learning` because training writes run folders and `report` reads them: a
reader of a run needs neither PyTorch nor the code that made it. The only file that needs PyTorch,
the checkpoint, belongs to `magical_baselines.checkpoints`; only its name is defined here.
"""

from magical.runs.folder import is_run, read_json, versions
from magical.runs.metrics import read_metrics

__all__ = ["is_run", "read_json", "read_metrics", "versions"]
