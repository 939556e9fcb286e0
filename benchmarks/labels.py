"""How an expert labels the episodes of another policy, by what it keeps in memory.

    python benchmarks/labels.py runs/dagger/dagger-MatchRegions-0/aggregate

For an expert that keeps its whole memory, one that drops it at every step, and one that takes over
where another action than its own was executed, as in DAgger: the share of labels that are moves of
escape, and the share that are the label of the expert without memory.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magical.demos import Dataset, Trajectory
from magical.experts import Memory, StateView, expert_for
from magical.experts.memory import note_motion, note_other_action
from magical.physics import Simulation
from magical.scene import Poses, State

Update = Callable[[Memory, int, int], Memory]  # from the memory, the label, the executed action


def take_over(memory: Memory, label: int, executed: int) -> Memory:
    """What the expert keeps in DAgger and in perturbed demonstrations."""
    return memory if label == executed else note_other_action(memory, executed)


KINDS: dict[str, Update] = {
    "no memory": lambda memory, label, executed: Memory(),
    "takes over": take_over,
    "whole memory": lambda memory, label, executed: memory,
}


def labels(trajectory: Trajectory, update: Update) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The expert's labels (T,) along an episode, and whether each is a move of escape."""
    expert, memory = expert_for(trajectory.task.name, seed=trajectory.seed), Memory()
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    found, escapes = [], []
    for step, executed in enumerate(trajectory.actions.tolist()):
        table = simulation.read().copy()
        poses = Poses(table[:, :3])
        state = State(trajectory.scene, poses, table[:, 3:], step, len(trajectory))
        escapes.append(note_motion(StateView.from_state(state), memory).escape_steps > 0)
        label, memory = expert.act(state, memory)
        found.append(label)
        memory = update(memory, label, executed)
        simulation.step(executed)
    return np.array(found), np.array(escapes)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path, help="episodes whose seeds are known")
    episodes = list(Dataset.open(parser.parse_args().dataset))
    reference = np.concatenate([labels(t, KINDS["no memory"])[0] for t in episodes])
    for name, update in KINDS.items():
        parts = [labels(trajectory, update) for trajectory in episodes]
        found, escapes = (np.concatenate(column) for column in zip(*parts, strict=True))
        agree = (found == reference).mean()
        print(f"{name:12}  escapes {escapes.mean():.3f}  as without memory {agree:.3f}")


if __name__ == "__main__":
    main()
