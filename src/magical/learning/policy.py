"""Trained networks as policies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical.envs import parse_env_id
from magical.errors import ObservationError, PolicyError, RunFolderError
from magical.evaluation.policy import Actions, Mask
from magical.learning.algorithms import find_algorithm
from magical.learning.augment import to_unit
from magical.learning.checkpoints import load_module, load_tree
from magical.learning.config import Config
from magical.learning.devices import Compute, choose_device
from magical.learning.runs import CHECKPOINT, CONFIG, RECORD, read_json
from magical.observe import ObservationSpec


class NetworkPolicy:
    """Samples actions from a network's distribution (or takes the likeliest)."""

    def __init__(
        self,
        network: nn.Module,
        tasks: Sequence[str],
        observation: str,
        spec: ObservationSpec,
        compute: Compute,
        greedy: bool = False,
    ) -> None:
        self.network = network.eval()
        self.tasks = tuple(tasks)
        self.observation = observation
        self.greedy = greedy
        self._spec = spec
        self._compute = compute

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One action for each world.

        Raises:
            PolicyError: observations of another shape, or a task that was not learned.
        """
        probabilities = self.probabilities(observations, env_ids)
        if self.greedy:
            likeliest: Actions = probabilities.argmax(axis=1)
            return likeliest
        below = probabilities.cumsum(axis=1)  # (B, 18)
        draws = rng.random(len(env_ids)) * below[:, -1]
        actions: Actions = (draws[:, None] >= below).sum(axis=1).clip(max=below.shape[1] - 1)
        return actions

    def reset(self, mask: Mask) -> None:
        """Nothing to forget: what was before is in the frame stack."""

    def probabilities(self, observations: Any, env_ids: Sequence[str]) -> NDArray[np.float64]:
        """The distribution over actions, (B, 18) float64."""
        inputs = to_inputs(observations, self._spec).to(self._compute.device)
        tasks = self._task_numbers(env_ids).to(self._compute.device)
        with torch.inference_mode(), self._compute.autocast():
            logits = self.network(to_unit(inputs), tasks)  # (B, 18)
        probabilities: NDArray[np.float64] = logits.double().softmax(dim=1).cpu().numpy()
        return probabilities

    def _task_numbers(self, env_ids: Sequence[str]) -> Tensor:
        numbers = {}
        for env_id in dict.fromkeys(env_ids):
            task = parse_env_id(env_id).task
            if task not in self.tasks:
                raise PolicyError(
                    f"policy: expected environments of the tasks it learned, "
                    f"{', '.join(self.tasks)}; found {env_id}"
                )
            numbers[env_id] = self.tasks.index(task)
        return torch.tensor([numbers[env_id] for env_id in env_ids])


def to_inputs(observations: Any, spec: ObservationSpec) -> Tensor:
    """Observations of an environment as a network's input, sharing their memory.

    Raises:
        PolicyError: they are of another shape or type than the specification says.
    """
    try:
        return torch.from_numpy(spec.network_input(observations))
    except ObservationError as error:
        raise PolicyError(str(error)) from error


def is_run(path: Path | str) -> bool:
    """Whether a path is a run folder."""
    return (Path(path) / CONFIG).is_file()


def load_policy(run: Path | str, device: str = "auto", greedy: bool = False) -> NetworkPolicy:
    """The policy of a run folder, as its newest checkpoint has it.

    Raises:
        RunFolderError: no run folder, or a damaged one.
        CheckpointError: no checkpoint yet, a damaged one, or one of another network.
    """
    folder = Path(run)
    if not is_run(folder):
        raise RunFolderError(f"{folder}: expected a run folder with {CONFIG}, found none")
    config = read_config(folder)
    network = find_algorithm(config.algorithm).make_policy(config)
    where = choose_device(device)
    tree = load_tree(folder / CHECKPOINT)
    load_module(network, tree["policy"], str(folder / CHECKPOINT))
    recorded = read_json(folder / RECORD)["compute"]
    same = where == recorded["device"]
    compute = Compute(where, recorded["precision"] if same else "float32")
    return NetworkPolicy(
        network.to(where),
        config.tasks,
        config.observation,
        config.observation_spec,
        compute,
        greedy,
    )


def read_config(folder: Path) -> Config:
    """The configuration recorded in a run folder."""
    data = read_json(folder / CONFIG)
    return find_algorithm(str(data.get("algorithm"))).config.from_dict(data)
