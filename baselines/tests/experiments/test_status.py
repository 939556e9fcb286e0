"""How far a plan is."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from magical_baselines.experiments import display
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.results import Outcome
from magical_baselines.experiments.status import RunStatus, Status


def run(method: str, state: str, **more: Any) -> RunStatus:
    options = {"tasks": ("MakeLine",), "seed": 0, "total": 10, "step": 0, **more}
    return RunStatus(folder="x", method=method, state=state, **options)


@pytest.mark.parametrize(("slots", "expected"), [(1, 35.0), (2, 17.5), (9, 15.0)])
def test_time_left_is_that_of_the_methods_finished_runs_or_of_all(
    slots: int, expected: float
) -> None:
    runs = (
        run("a", "done", seconds=10.0),
        run("a", "done", seconds=20.0),
        run("b", "done", seconds=30.0),
        run("a", "waiting"),  # 15 s
        run("c", "running", step=5, total=10),  # half of 20 s
        run("c", "running", step=5, total=10),
        run("b", "failed"),
    )
    assert Status(Path(), True, slots, runs, 0).seconds_left() == pytest.approx(expected)
    assert Status(Path(), True, slots, runs[3:], 0).seconds_left() is None


def test_without_a_terminal_a_line_now_and_then_says_how_far_the_plan_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = (run("a", "done", seconds=10.0), run("a", "running", step=5), run("a", "waiting"))
    monkeypatch.setattr(display, "read_status", lambda path: Status(path, True, 1, runs, 0))
    with display.Display(Path()) as shown:
        shown.refresh()  # too soon
        monkeypatch.setattr(display, "LINE_INTERVAL", -1.0)
        shown.refresh()
    assert capsys.readouterr().err == (
        "1 of 3 runs done, 1 in progress, 15 of 30 steps, about 0:00:15 left\n"
    )


def test_before_any_run_is_finished_the_time_left_follows_from_the_speed_of_training(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = display.Display(Path())
    shown._last_line = 0.0
    for now, steps in ((20.0, (0, 0)), (25.0, (50, 50)), (35.0, (150, 150))):
        monkeypatch.setattr("time.monotonic", lambda now=now: now)
        runs = [run("a", "running", step=step, total=1000) for step in steps]
        found = Status(Path(), True, 2, tuple(runs), 0)
        monkeypatch.setattr(display, "read_status", lambda path, found=found: found)
        shown.refresh()
    assert capsys.readouterr().err == (
        "0 of 2 runs done, 2 in progress, 300 of 2,000 steps, about 0:01:25 of training left, then "
        "evaluation\n"
    )


def test_durations_are_in_hours_or_in_days() -> None:
    found = [display.duration(seconds) for seconds in (59.6, 3_725.0, 90_000.0, 117_299_291.0)]
    assert found == ["0:01:00", "1:02:05", "25:00:00", "1,358 days"]


def test_a_plan_that_nobody_executes_names_the_command_that_continues_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    runs = (run("a", "done"), run("a", "waiting"))
    for command, again in (
        ((), "magical run PLAN --out 'my runs'\n"),
        (("run", "my plan.toml"), "magical run 'my plan.toml' --out 'my runs'\n"),
    ):
        found = Status(Path("my runs"), False, 1, runs, 0, command)
        Console(soft_wrap=True).print(display.status_table(found))
        assert capsys.readouterr().out.endswith(f"to continue it: {again}")


def test_the_end_of_a_run_is_a_line_with_its_time_where_that_is_known(
    planned: Callable[..., list[PlannedRun]], capsys: pytest.CaptureFixture[str]
) -> None:
    shown, (ended, _) = display.Display(Path()), planned()
    shown.ended(ended, Outcome("done", 61.0))
    shown.ended(ended, Outcome("interrupted"))
    lines = [f"done: {ended} (0:01:01)", f"interrupted: {ended}"]
    assert capsys.readouterr().err.splitlines() == lines
