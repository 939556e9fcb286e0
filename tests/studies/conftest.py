"""Plans that take seconds and entries as `magical evaluate` writes them, as for other rooms."""

from importlib import import_module
from importlib.util import find_spec

import pytest

from baselines.tests.experiments.conftest import finished, planned, tiny
from magical.tasks import TASKS, unregister_task
from tests.report.conftest import write_entry

__all__ = ["finished", "planned", "tiny", "write_entry"]

# What executes plans cannot even be imported without PyTorch.
NEED_TORCH = ("collecting", "contradictions", "pages")
collect_ignore = [] if find_spec("torch") else [f"test_{name}.py" for name in NEED_TORCH]


@pytest.fixture(scope="module")
def outside_tasks():
    """The module of the tasks outside the language of goals, which are registered."""
    module = import_module("studies.outside_tasks.tasks")
    names = (*module.DEVELOPMENT, *module.HELD_BACK)
    if names[0] not in TASKS:  # registered once, and not any more
        module.register()
    yield module
    for name in names:
        unregister_task(name)
