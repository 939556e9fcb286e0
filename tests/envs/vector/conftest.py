"""A task from outside the package with a faulty score function."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from magical.tasks import register_task, unregister_task

MODULE = """
import os
from dataclasses import replace
from magical import get_task, register_task

class Unprintable(Exception):
    def __str__(self):
        raise RuntimeError("no text")
    __repr__ = __str__

def score_fn(scene, poses):
    {body}

TASK = replace(get_task("MakeLine"), name="Misbehaving", score_fn=score_fn)
"""
ENV_ID = "magical/Misbehaving-Demo-v0"
Misbehave = Callable[[str], str]


@pytest.fixture
def misbehave(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Misbehave]:
    """Registers the task with a body of its score function; returns its environment id."""

    def register(body: str) -> str:
        (tmp_path / "misbehaving_task.py").write_text(MODULE.replace("{body}", body))
        monkeypatch.syspath_prepend(tmp_path)
        register_task(__import__("misbehaving_task").TASK)
        return ENV_ID

    yield register
    unregister_task("Misbehaving")
    sys.modules.pop("misbehaving_task", None)
