"""Worker processes and an expert from outside the package."""

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from magical.demos import Dataset
from magical.demos.generate import generate
from magical.errors import InvalidTaskError
from magical.evaluation import evaluate
from magical.evaluation.policy import ExpertPolicy
from magical.experts import modules_of
from magical.tasks import get_task, register_task, unregister_task
from tests.experts import outside_task

ENV = "magical/MoveThere-TestLayout-v0"


@pytest.fixture
def outside() -> Iterator[None]:
    import_module("tests.experts.outside_expert")
    register_task(outside_task.TASK)
    yield
    unregister_task("MoveThere")


@pytest.mark.usefixtures("outside")
def test_workers_import_a_task_and_its_expert(tmp_path: Path) -> None:
    modules = ["tests.experts.outside_expert", "tests.experts.outside_task"]
    assert modules_of("MoveThere") == modules
    here, there = (
        evaluate(ExpertPolicy(), [ENV], rollouts=3, workers=workers) for workers in (1, 2)
    )
    assert here == there
    generate(ENV, 2, tmp_path, workers=2)
    assert [entry.task for entry in Dataset.open(tmp_path).entries] == ["MoveThere"] * 2


def test_what_workers_could_not_import_is_an_error_at_once(tmp_path: Path) -> None:
    task = register_task(replace(get_task("MakeLine"), name="MakeOther", section=""))
    env_id = "magical/MakeOther-Demo-v0"
    try:
        with pytest.raises(InvalidTaskError, match="MakeOther"):
            evaluate(ExpertPolicy(), [env_id], rollouts=100, workers=2)
        with pytest.raises(InvalidTaskError, match="MakeOther"):
            generate(env_id, 2, tmp_path / "out", workers=2)
        assert not (tmp_path / "out").exists()
    finally:
        assert unregister_task("MakeOther") is task
