"""Plans that take seconds and entries as `magical evaluate` writes them, as for other rooms."""

from importlib.util import find_spec

from baselines.tests.experiments.conftest import finished, planned, tiny
from tests.report.conftest import write_entry

__all__ = ["finished", "planned", "tiny", "write_entry"]

# What executes plans cannot even be imported without PyTorch.
NEED_TORCH = ("collecting", "pages")
collect_ignore = [] if find_spec("torch") else [f"test_{name}.py" for name in NEED_TORCH]
