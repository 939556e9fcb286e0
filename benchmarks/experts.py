"""Measures the scripted experts: python benchmarks/experts.py [SECTION]...

Sections: speed, lengths, takeover, skill, diversity, states (default: all). Needs no files. For
scores in all environments, use `magical expert evaluate`.
"""

import sys
import time
from collections.abc import Iterator

import numpy as np

from magical.envs import all_env_ids
from magical.evaluation import evaluate
from magical.evaluation.expert import ExpertPolicy
from magical.experts import ExpertEpisode, expert_for, rollout
from magical.scene import NUM_ACTIONS, Poses, Scene, State
from magical.tasks import TASKS, get_task

DEMOS = [env_id for env_id in all_env_ids() if env_id.endswith("-Demo-v0")]
SKILLS = (1.0, 0.75, 0.5, 0.25)
STATES = 10_000


def main() -> None:
    names = sys.argv[1:] or list(SECTIONS)
    for name in names:
        print(f"\n{name}")
        for line in SECTIONS[name]():
            print("  " + line, flush=True)


def speed() -> Iterator[str]:
    """Expert steps per second of CPU time on one core, including physics."""
    steps, begin = 0, time.process_time()
    for task in TASKS:
        own_steps, own_begin = 0, time.process_time()
        for seed in range(8):
            own_steps += len(rollout(task, "TestAll", seed).actions)
        steps += own_steps
        yield f"{task:14} {own_steps / (time.process_time() - own_begin):8.0f} steps/s"
    yield f"{'all':14} {steps / (time.process_time() - begin):8.0f} steps/s"
    begin = time.process_time()
    for task in TASKS:
        for seed in range(25):
            rollout(task, "Demo", seed)
    yield f"25 Demo episodes of each task: {time.process_time() - begin:.0f} s of one core"


def lengths() -> Iterator[str]:
    """Control steps to lasting success in Demo."""
    for task in TASKS:
        steps = [lasting(task, rollout(task, "Demo", seed)) for seed in range(50)]
        done = [count for count in steps if count is not None]
        low, middle, high = np.percentile(done, (10, 50, 90))
        yield f"{task:14} median {middle:.0f}, 10% to 90%: {low:.0f} to {high:.0f}"


def lasting(task: str, done: ExpertEpisode) -> int | None:
    """The first step from which the score stays 1 until the end; `None` if there is none."""
    spec = get_task(task)
    scores = [spec.score(done.scene, Poses(poses)) for poses in done.poses]
    if scores[-1] < 1.0:
        return None
    return next((i + 1 for i in range(len(scores) - 1, -1, -1) if scores[i] < 1.0), 0)


def demo_means(policy: ExpertPolicy, rollouts: int) -> dict[str, float]:
    """Mean score in the Demo variant of each task."""
    rows = evaluate(policy, DEMOS, rollouts=rollouts)
    return {e: float(np.mean([row.score for row in rows if row.env_id == e])) for e in DEMOS}


def takeover() -> Iterator[str]:
    """A random policy for the first third of the horizon, then the expert."""
    means = demo_means(ExpertPolicy(random_share=1 / 3), rollouts=100)
    for env_id, mean in means.items():
        yield f"{env_id:32} {mean:.3f}"
    rest = [mean for env_id, mean in means.items() if "Cluster" not in env_id]
    yield f"all tasks {np.mean(list(means.values())):.3f}, without Cluster {np.mean(rest):.3f}"


def skill() -> Iterator[str]:
    """Mean scores over the Demo environments at four skill levels."""
    table = {s: demo_means(ExpertPolicy(skill=s), rollouts=25) for s in SKILLS}
    for env_id in DEMOS:
        yield f"{env_id:32} " + " ".join(f"{table[s][env_id]:.3f}" for s in SKILLS)
    yield f"{'mean':32} " + " ".join(f"{np.mean(list(table[s].values())):.3f}" for s in SKILLS)


def diversity() -> Iterator[str]:
    """Distinct block orders and placements (to about a block) in 25 successful Demo episodes."""
    for task in ("MatchRegions", "MakeLine", "ClusterColour", "ClusterShape"):
        orders, placements, found, seed = set(), set(), 0, 0
        while found < 25:
            done = rollout(task, "Demo", seed)
            seed += 1
            if done.score < 1.0:
                continue
            found += 1
            blocks = done.poses[:, 5:, :2]  # (T + 1, blocks, 2)
            moved = np.linalg.norm(blocks - blocks[0], axis=2) > 0.15
            when = np.where(moved.any(axis=0), moved.argmax(axis=0), 10_000)
            orders.add(tuple(i for i in np.argsort(when, kind="stable") if when[i] < 10_000))
            placements.add(tuple(np.floor(blocks[-1] * 4).astype(int).ravel().tolist()))
        yield f"{task:14} {len(orders):2} orders, {len(placements):2} placements, quarter-unit grid"


def states() -> Iterator[str]:
    """Check that the expert returns a valid action in random states of every task."""
    rng = np.random.default_rng(0)
    for task in TASKS:
        spec, memory = get_task(task), None
        for number in range(STATES):
            if number % 10 == 0:
                scene, _ = spec.sample(spec.variants[number // 10 % len(spec.variants)], rng)
                expert, memory = expert_for(task, rng=rng), None
            action, memory = expert.act(_scattered(scene, rng), memory)
            if action not in range(NUM_ACTIONS):
                raise SystemExit(f"{task}: action {action}")
        yield f"{task:14} {STATES} states"


def _scattered(scene: Scene, rng: np.random.Generator) -> State:
    poses = Poses.at_rest(scene).bodies.copy()
    poses[:, :2] = rng.uniform(-0.88, 0.88, size=(len(poses), 2))
    poses[:, 2] = rng.uniform(-20, 20, size=len(poses))
    return State(scene, Poses(poses), rng.normal(size=poses.shape), 0, 100)


SECTIONS = {
    "speed": speed,
    "lengths": lengths,
    "takeover": takeover,
    "skill": skill,
    "diversity": diversity,
    "states": states,
}

if __name__ == "__main__":
    main()
