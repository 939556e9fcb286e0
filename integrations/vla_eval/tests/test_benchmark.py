"""The benchmark under vla-eval's own runner, against servers of known policies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vla_eval.api import evaluate
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval_magical import MagicalBenchmark

from magical.envs import parse_env_id
from magical.envs.seeds import evaluation_seed
from magical.experts import rollout
from magical.scene import ACTIONS

TASK = "MoveToCorner"
VARIANTS = ["Demo", "TestJitter"]
SIGNS = (0, 1, -1)  # of stop, forward, back; of straight, left, right
POINTS = [(SIGNS[a.longitudinal], SIGNS[a.turn], 2 * a.gripper - 1) for a in ACTIONS]


class ExpertServer(PredictModelServer):
    """Replays the scripted expert's actions of the episode that the harness plays."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[dict[str, Any]] = []
        self.actions: dict[str, Any] = {}

    async def on_episode_start(self, config: dict[str, Any], ctx: Any) -> None:
        await super().on_episode_start(config, ctx)
        task = config["task"]
        self.actions[ctx.session_id] = actions_of(task["env_id"], task["episode_idx"])

    def predict(self, obs: Any, ctx: Any) -> dict[str, Any]:
        if ctx.is_first:
            self.seen.append(obs)
        return {"actions": self.actions[ctx.session_id][ctx.step]}


class StillServer(PredictModelServer):
    def predict(self, obs: Any, ctx: Any) -> dict[str, Any]:
        return {"actions": np.array([0.0, 0.0, -1.0], np.float32)}


def actions_of(env_id: str, episode: int) -> Any:
    """The expert's actions in an episode, as continuous ones."""
    parsed = parse_env_id(env_id)
    episode_of = rollout(parsed.task, parsed.variant, evaluation_seed(episode, 0))
    return np.array([POINTS[action] for action in episode_of.actions.tolist()], np.float32)


def played(server: PredictModelServer, folder: Path) -> list[dict[str, Any]]:
    config = {
        "benchmarks": [
            {
                "benchmark": "vla_eval_magical:MagicalBenchmark",
                "episodes_per_task": 2,
                "params": {"tasks": [TASK], "variants": VARIANTS, "seed": 0},
            }
        ],
        "output_dir": str(folder),
    }
    results: list[dict[str, Any]] = evaluate(server, config, docker=False)
    return results


def test_the_expert_succeeds_and_standing_still_does_not(tmp_path: Path) -> None:
    server = ExpertServer()
    (expert,) = played(server, tmp_path / "expert")
    (still,) = played(StillServer(), tmp_path / "still")
    assert expert["mean_success"] == 1.0
    assert still["mean_success"] == 0.0
    names = [task["task"] for task in expert["tasks"]]
    assert names == [f"{TASK}-{variant}" for variant in VARIANTS]
    assert all(task["mean_score"] > 0.9 for task in expert["tasks"])
    first = server.seen[0]
    assert first["images"]["ego"].shape == first["images"]["allo"].shape == (96, 96, 3)
    assert first["state"].shape == (5,)
    assert "corner" in first["task_description"]


def test_an_action_that_is_not_finite_is_named() -> None:
    import asyncio

    benchmark = MagicalBenchmark([TASK], ["Demo"])
    asyncio.run(benchmark.start_episode(benchmark.get_tasks()[0]))
    with pytest.raises(ValueError, match="nan"):
        benchmark.step({"actions": np.array([np.nan, 0, 0])})
    benchmark.cleanup()
