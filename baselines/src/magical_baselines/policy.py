"""Trained networks as policies, loaded from run folders."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical.envs import parse_env_id
from magical.errors import DivergedError, ObservationError, PolicyError
from magical.evaluation.policy import Actions, Mask
from magical.observe import ObservationSpec
from magical.runs.folder import CHECKPOINT, RECORD, read_json
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.checkpoints import load_checkpoint, restoring
from magical_baselines.compute import (
    Compute,
    choose_device,
    cpu_threads,
    full_float32,
    read_compute,
)
from magical_baselines.config import Config, find_algorithm, read_config


class TrainedPolicy:
    """Base class of the policies of trained networks.

    Attributes:
        network, config, greedy: see `__init__`.
        tasks, observation, action_space: as in training.
        updates: how many updates of training are done and how many planned, if it is of a run.
    """

    updates: tuple[int, int] | None = None

    def __init__(
        self, network: nn.Module, config: Config, compute: Compute, greedy: bool = False
    ) -> None:
        """Create a policy that acts as its training configuration says.

        The network takes observations (B, ...) and tasks (B,). Pixels are first scaled to [0, 1],
        unless its attribute `takes_pixels` is true. A `greedy` policy takes the most probable
        discrete action instead of sampling.
        """
        self.network = network.eval()
        self.config = config
        self.tasks = config.tasks
        self.observation = config.observation
        self.action_space = config.action_space
        self.greedy = greedy
        self._spec = config.observation_spec
        self._compute = compute

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One action for each environment: (B,) int64, or (B, 3) float64 if continuous.

        Raises:
            PolicyError: observations of the wrong shape, or a task that it was not trained on.
            DivergedError: the network's outputs are not finite.
        """
        raise NotImplementedError

    @property
    def record(self) -> dict[str, Any]:
        """What entries state: algorithm, seed, what was learned from, CPU threads."""
        return {**self.config.training_details, "threads": torch.get_num_threads()}

    def using_threads(self, number: int) -> AbstractContextManager[None]:
        """A context in which the network uses this number of CPU threads."""
        return cpu_threads(number)

    def reset(self, mask: Mask) -> None:
        """Start new episodes where the mask (B,) is true; does nothing unless overridden."""

    def outputs(self, observations: Any, env_ids: Sequence[str], *others: Tensor) -> Tensor:
        """The network's outputs, float64 on the CPU; raises what `act` raises.

        `others` are further inputs to the network.
        """
        inputs = to_inputs(observations, self._spec).to(self._compute.device)
        if not getattr(self.network, "takes_pixels", False):
            inputs = to_unit(inputs)
        return self.computed(self.network, inputs, self.task_numbers(env_ids), *others)

    def computed(self, function: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
        """Outputs of a function of the network, in the policy's precision; float64 on the CPU."""
        with torch.inference_mode(), full_float32(), self._compute.autocast():
            outputs = function(*(each.to(self._compute.device) for each in inputs))
        found: Tensor = outputs.double().cpu()
        if not torch.isfinite(found).all():
            raise DivergedError(
                "policy: expected finite outputs, found others; the weights are not finite, or too "
                "large for the precision"
            )
        return found

    def task_numbers(self, env_ids: Sequence[str]) -> Tensor:
        """The position (B,) of each environment's task; raises `PolicyError` if not learned."""
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


class NetworkPolicy(TrainedPolicy):
    """Samples actions from a network's distribution, or takes the most probable ones.

    The network returns logits (B, 18). The only memory is the observation's frame stack.
    """

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        return choose_actions(self.probabilities(observations, env_ids), rng, self.greedy)

    def probabilities(self, observations: Any, env_ids: Sequence[str]) -> NDArray[np.float64]:
        """The distribution over actions, (B, 18) float64; raises what `act` raises."""
        return self.outputs(observations, env_ids).softmax(1).numpy()


def choose_actions(
    probabilities: NDArray[np.float64], rng: np.random.Generator, greedy: bool = False
) -> NDArray[np.int64]:
    """Choose actions (B,) from distributions (B, 18): sampled, or the most probable ones."""
    if greedy:
        actions: NDArray[np.int64] = probabilities.argmax(axis=1)
        return actions
    return sample_actions(probabilities, rng.random(len(probabilities)))


def sample_actions(
    probabilities: NDArray[np.float64], uniforms: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Sample actions (B,) from distributions (B, 18) by uniform random numbers (B,) in [0, 1)."""
    cumulative = probabilities.cumsum(axis=1)
    thresholds = uniforms * cumulative[:, -1]
    actions: NDArray[np.int64] = (thresholds[:, None] >= cumulative).sum(axis=1)
    return actions.clip(max=cumulative.shape[1] - 1)


def to_inputs(observations: Any, spec: ObservationSpec) -> Tensor:
    """An environment's observations as a network's input, in the same memory; `PolicyError`."""
    try:
        return torch.from_numpy(spec.network_input(observations))
    except ObservationError as error:
        raise PolicyError(str(error)) from error


def load_policy(run: Path | str, device: str = "auto", greedy: bool = False) -> TrainedPolicy:
    """Load the policy from the newest checkpoint of a run folder.

    A `greedy` one takes the most probable action instead of sampling, which has no effect on
    continuous actions: `diffusion` always samples, `act` with such actions never does.

    Raises:
        RunFolderError: the folder is not a run folder, or is damaged.
        CheckpointError: there is no checkpoint yet, or it is damaged or of another network.
    """
    folder = Path(run)
    config = read_config(folder)
    algorithm = find_algorithm(config.algorithm)
    network = algorithm.make_policy(config)
    chosen = choose_device(device)
    state = load_checkpoint(folder / CHECKPOINT)
    with restoring(folder / CHECKPOINT):
        network.load_state_dict(state["policy"])
        done = int(state["step"])
    recorded = read_compute(read_json(folder / RECORD), folder)
    precision = recorded.precision if recorded and chosen == recorded.device else "float32"
    kind = algorithm.policy or NetworkPolicy
    policy = kind(network.to(chosen), config, Compute(chosen, precision), greedy)
    policy.updates = done, config.num_updates
    return policy
