"""How an expert labels the episodes of another policy, by what it keeps in memory.

    python studies/learners/labels.py runs/dagger/dagger-MatchRegions-0/aggregate
    python studies/learners/labels.py --alone MatchRegions ClusterColour

For an expert that keeps its whole memory, one that drops it at every step, and one that takes over
where another action than its own was executed, as in DAgger: the share of labels that are moves of
escape, and the share that are the label of the expert without memory. With `--alone`, the scores
and the time per label with and without memory where the expert acts itself, in Demo.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magical.demos import Dataset, Trajectory
from magical.envs.seeds import episode_seed
from magical.experts import Memory, StateView, expert_for, strategy_seed
from magical.experts.memory import note_motion, note_other_action
from magical.physics import Simulation
from magical.scene import Poses, Scene, State
from magical.tasks import get_task

Update = Callable[[Memory, int, int], Memory]  # from the memory, the label, the executed action


def take_over(memory: Memory, label: int, executed: int) -> Memory:
    """What the expert keeps in DAgger and in perturbed demonstrations."""
    return memory if label == executed else note_other_action(memory, executed)


KINDS: dict[str, Update] = {
    "no memory": lambda memory, label, executed: Memory(),
    "takes over": take_over,
    "whole memory": lambda memory, label, executed: memory,
}


def present(simulation: Simulation, scene: Scene, step: int, horizon: int) -> State:
    table = simulation.read()
    return State(scene, Poses(table[:, :3]), table[:, 3:], step, horizon)


def labels(trajectory: Trajectory, update: Update) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The expert's labels (T,) along an episode, and whether each is a move of escape."""
    seed = strategy_seed(trajectory.env_id.variant, trajectory.seed)
    expert, memory = expert_for(trajectory.task.name, seed=seed), Memory()
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    found, escapes = [], []
    for step, executed in enumerate(trajectory.actions.tolist()):
        state = present(simulation, trajectory.scene, step, len(trajectory))
        escapes.append(note_motion(StateView.from_state(state), memory).escape_steps > 0)
        label, memory = expert.act(state, memory)
        found.append(label)
        memory = update(memory, label, executed)
        simulation.step(executed)
    return np.array(found), np.array(escapes)


def compare(path: Path) -> None:
    """Print what each kind of expert says along the episodes of a dataset."""
    episodes = list(Dataset.open(path))
    reference = np.concatenate([labels(t, KINDS["no memory"])[0] for t in episodes])
    for name, update in KINDS.items():
        parts = [labels(trajectory, update) for trajectory in episodes]
        found, escapes = (np.concatenate(column) for column in zip(*parts, strict=True))
        agree = (found == reference).mean()
        print(f"{name:12}  escapes {escapes.mean():.3f}  as without memory {agree:.3f}")


def alone(task: str, update: Update, seed: int) -> tuple[float, float]:
    """The expert's score in Demo, and its processor time per label in milliseconds."""
    spec, expert, memory = get_task(task), expert_for(task, seed=seed), Memory()
    scene, dynamics = spec.sample("Demo", np.random.default_rng(seed))
    simulation, took = Simulation(scene, dynamics), 0.0
    for step in range(spec.horizon):
        state = present(simulation, scene, step, spec.horizon)
        began = time.process_time()
        action, memory = expert.act(state, memory)
        took += time.process_time() - began
        memory = update(memory, action, action)
        simulation.step(action)
    return spec.score(scene, simulation.poses()), 1000 * took / spec.horizon


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", nargs="?", type=Path, help="episodes whose seeds are known")
    parser.add_argument("--alone", nargs="+", default=[], metavar="TASK")
    parser.add_argument("--episodes", type=int, default=20, help="of each task (default: 20)")
    arguments = parser.parse_args()
    if arguments.dataset:
        compare(arguments.dataset)
    for task in arguments.alone:
        for name in ("no memory", "whole memory"):
            seeds = [episode_seed(5, number) for number in range(arguments.episodes)]
            score, took = np.mean([alone(task, KINDS[name], seed) for seed in seeds], axis=0)
            print(f"{task:12}  {name:12}  score {score:.3f}  {took:.2f} ms a label", flush=True)


if __name__ == "__main__":
    main()
