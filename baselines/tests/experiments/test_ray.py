"""Plans on a local Ray cluster of two worker processes."""

import signal
import socket
import threading
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="the extra ray is not installed")

from baselines.baselines.baselines.baselines.tests.experiments.conftest import Planned
from baselines.baselines.baselines.baselines.tests.experiments.processes import (
    TIMEOUT,
    reached,
    running,
    scores_of,
)
from ray.cluster_utils import Cluster

from magical.cli import main
from magical_baselines.experiments.execution import Resources, execute
from magical_baselines.experiments.ray_cluster import RayExecutor, pack, unpack
from magical_baselines.experiments.results import Results, opened
from magical_baselines.experiments.status import read_status


@pytest.fixture(autouse=True)
def no_usage_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is sent anywhere."""
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")


def test_the_scores_are_those_of_local_processes(
    planned: Planned, out: Path, finished: Path
) -> None:
    assert execute(planned(), out, Resources(executor="ray", workers=2)).complete
    assert scores_of(out) == scores_of(finished)


def test_without_a_shared_folder_runs_come_back_through_ray(
    planned: Planned, finished: Path, out: Path
) -> None:
    runs, demos = planned(), finished / "demos" / "expert-3"
    with opened(out, runs) as results:
        elsewhere = Results(results.path, "the id of another folder")
        executor = RayExecutor(runs, elsewhere, workers=2)
        try:
            started = [executor.start(run, demos) for run in runs]
            outcomes = [future.result() for future in started]
        finally:
            executor.close()
    assert [outcome.state for outcome in outcomes] == ["done", "done"]
    assert scores_of(out) == scores_of(finished)
    assert (out / "runs" / runs[0].folder / "checkpoint.safetensors").is_file()


def test_a_cluster_that_cannot_be_reached_is_named(
    tiny: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
    argv = ["run", str(tiny), "--out", str(out), "--executor", "ray"]
    assert main([*argv, "--address", address]) == 1
    message = capsys.readouterr().err
    assert f"the Ray cluster at {address} cannot be reached" in message
    assert "ray start --head" in message


@pytest.mark.posix
def test_sigterm_leaves_checkpoints(
    tiny: Path, planned: Planned, out: Path, finished: Path
) -> None:
    # With --workers in a cluster of its own, whatever else runs on this machine.
    with running(tiny, out, "--executor", "ray", "--workers", "2") as process:
        assert reached(out, 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT) == 130
    assert (out / "runs" / planned()[0].folder / "checkpoint.safetensors").is_file()
    assert execute(planned(), out, Resources(executor="ray", workers=2)).complete
    assert scores_of(out) == scores_of(finished)


def kill_node(cluster: Cluster, node: object, out: Path) -> None:
    """Kill a node once a run has begun in `out`."""
    assert reached(out, 1)
    cluster.remove_node(node, allow_graceful=False)


def test_runs_of_a_dead_node_are_done_by_another(
    planned: Planned,
    out: Path,
    finished: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("magical_baselines.experiments.ray_cluster.RETRIES", 0)  # Ray's own
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    node, _ = cluster.add_node(num_cpus=1), cluster.add_node(num_cpus=1)
    thread = threading.Thread(target=kill_node, args=(cluster, node, out))
    try:
        thread.start()
        assert execute(planned(), out, Resources(executor="ray", address=cluster.address)).complete
    finally:
        thread.join()
        cluster.shutdown()
    assert scores_of(out) == scores_of(finished)


def test_a_dead_cluster_is_no_failure_of_its_runs(
    tiny: Path, planned: Planned, out: Path, finished: Path
) -> None:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        with running(tiny, out, "--address", cluster.address) as process:
            assert reached(out, 1)
            cluster.head_node.kill_raylet()
            assert process.wait(TIMEOUT) == 1
    finally:
        cluster.shutdown()
    assert read_status(out).counts["failed"] == 0
    assert execute(planned(), out, Resources(executor="ray", workers=1)).complete
    assert scores_of(out) == scores_of(finished)


def test_a_packed_folder_replaces_an_older_one_or_a_file_of_it(tmp_path: Path) -> None:
    for name, text in (("a", "new"), ("b", "old")):
        (tmp_path / name / "deep").mkdir(parents=True)
        (tmp_path / name / "deep" / f"{text}.txt").write_text(text)
        (tmp_path / name / "result.json").write_text(text)
        (tmp_path / name / ".lock").touch()
    unpack(pack(tmp_path / "a"), tmp_path / "b", "result.json")
    assert (tmp_path / "b" / "result.json").read_text() == "new"
    assert (tmp_path / "b" / "deep" / "old.txt").exists()
    unpack(pack(tmp_path / "a"), tmp_path / "b")
    found = sorted(path.relative_to(tmp_path / "b").as_posix() for path in tmp_path.glob("b/**/*"))
    assert found == ["deep", "deep/new.txt", "result.json"]
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_a_planted_link_is_not_followed(tmp_path: Path) -> None:
    for name in ("a", "b", "others"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text(name)
    (tmp_path / ".b.part").symlink_to("others")
    unpack(pack(tmp_path / "a"), tmp_path / "b")
    assert (tmp_path / "b" / "result.json").read_text() == "a"
    assert (tmp_path / "others" / "result.json").read_text() == "others"
