"""A task from outside the package."""

from dataclasses import replace

from magical.tasks import get_task

TASK = replace(get_task("MoveToRegion"), name="MoveThere", section="")
