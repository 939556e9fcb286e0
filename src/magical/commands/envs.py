"""List the tasks, their horizons and variants, and the observation presets."""

import argparse

from magical.commands._common import add_json, print_json, print_table
from magical.envs import all_env_ids
from magical.observe import PRESETS
from magical.tasks import importable_tasks


def configure(parser: argparse.ArgumentParser) -> None:
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    ids, tasks = all_env_ids(presets=True), importable_tasks()
    rows = [(task.name, task.horizon, " ".join(task.variants)) for task in tasks]
    print_table(("task", "horizon", "variants"), rows)
    print("\nenvironment ids: magical/<task>-<variant>[-<preset>]-v0")
    print(f"presets: {' '.join(PRESETS)}")
    print(f"{len(all_env_ids())} environments, {len(ids)} ids, with and without presets")
    described = {
        task.name: {
            "horizon": task.horizon,
            "variants": list(task.variants),
            "summary": task.summary,
        }
        for task in tasks
    }
    print_json(args, {"tasks": described, "presets": list(PRESETS), "ids": ids})
    return 0
