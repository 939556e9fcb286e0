"""Plans on a local Ray cluster of two worker processes."""

import signal

import pytest

pytest.importorskip("ray", reason="the extra ray is not installed")

from ray.cluster_utils import Cluster

from baselines.tests.experiments.conftest import TIMEOUT, reached, running, scores_of
from magical_baselines.experiments.cluster import RayTasks
from magical_baselines.experiments.execution import execute
from magical_baselines.experiments.plan import PlannedReference
from magical_baselines.experiments.status import read_status


@pytest.fixture(autouse=True)
def no_usage_statistics(monkeypatch):
    """Nothing is sent anywhere."""
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")


@pytest.mark.parametrize("shared", [True, False])
def test_the_scores_are_those_of_local_processes(planned, out, finished, shared):
    runs, tasks = planned(), RayTasks(out, None, 2, 0)
    if not shared:
        tasks.marker.rmdir()  # as if a node saw another folder
    references = [PlannedReference("noop", runs[0].evaluation)]
    assert not execute(runs, out, tasks, references=references, workers=1)
    assert read_status(out).complete
    assert scores_of(out) == scores_of(finished)
    assert (out / "runs" / runs[0].folder / "checkpoint.safetensors").is_file()


@pytest.mark.posix
def test_sigterm_leaves_checkpoints(tiny, planned, out):
    # With --workers in a cluster of its own, whatever else runs on this machine.
    with running(tiny, out, "--executor", "ray") as process:
        assert reached(out, 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT) == 130
    assert (out / "runs" / planned()[0].folder / "checkpoint.safetensors").is_file()
    assert read_status(out).counts["failed"] == 0


def test_a_dead_cluster_is_no_failure_of_its_runs(tiny, out):
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        with running(tiny, out, "--address", cluster.address) as process:
            assert reached(out, 1)
            cluster.head_node.kill_raylet()
            assert process.wait(TIMEOUT) == 1
    finally:
        cluster.shutdown()
    assert read_status(out).counts["failed"] == 0
