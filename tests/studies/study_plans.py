"""Reading the plans of the studies."""

import re
from pathlib import Path

from magical.plugins import import_user_module
from magical_baselines.experiments.plan import Plan, read_plan


def read_study_plan(path: Path) -> Plan:
    """A study's plan, read after the imports of the commands in its header."""
    for module in re.findall(r"^#.* --import (\S+)", path.read_text(), re.MULTILINE):
        import_user_module(module)
    return read_plan(path)
