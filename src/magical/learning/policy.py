"""Trained networks as policies."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical.envs import parse_env_id
from magical.errors import DivergedError, ObservationError, PolicyError
from magical.evaluation.policy import Actions, Mask
from magical.learning.augmentation.augment import to_unit
from magical.learning.config import Config
from magical.learning.running.devices import Compute, full_float32
from magical.observe import ObservationSpec


class NetworkPolicy:
    """Samples actions from a network's distribution, or takes the most probable ones."""

    def __init__(
        self, network: nn.Module, config: Config, compute: Compute, greedy: bool = False
    ) -> None:
        """Create a policy.

        Args:
            network: maps observations (B, ...) and tasks (B,) to logits (B, 18). Pixels are scaled
                to [0, 1] before, but for a network whose attribute `takes_pixels` is true.
            config: of its training: the tasks and the observation.
            compute: device and precision.
            greedy: take the most probable action instead of sampling.
        """
        self.network = network.eval()
        self.tasks = config.tasks
        self.observation = config.observation
        self.greedy = greedy
        self._spec = config.observation_spec
        self._compute = compute

    def act(self, observations: Any, env_ids: Sequence[str], rng: np.random.Generator) -> Actions:
        """One action for each environment, (B,) int64.

        Raises:
            PolicyError: observations of another shape, or a task that it was not trained on.
            DivergedError: the network's logits are not finite.
        """
        probabilities = self.probabilities(observations, env_ids)
        if self.greedy:
            most_probable: Actions = probabilities.argmax(axis=1)
            return most_probable
        return sample_actions(probabilities, rng)

    def reset(self, mask: Mask) -> None:
        """Does nothing: the only memory is the observation's frame stack."""

    def probabilities(self, observations: Any, env_ids: Sequence[str]) -> NDArray[np.float64]:
        """The distribution over actions, (B, 18) float64; raises what `act` raises."""
        inputs = to_inputs(observations, self._spec).to(self._compute.device)
        tasks = self._task_numbers(env_ids).to(self._compute.device)
        with torch.inference_mode(), full_float32(), self._compute.autocast():
            if not getattr(self.network, "takes_pixels", False):
                inputs = to_unit(inputs)
            logits = self.network(inputs, tasks)  # (B, 18)
        logits = logits.double().cpu()
        _require_finite(logits)
        probabilities: NDArray[np.float64] = logits.softmax(dim=1).numpy()
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


def sample_actions(probabilities: NDArray[np.float64], rng: np.random.Generator) -> Actions:
    """One action (B,) int64 from each of the distributions (B, 18)."""
    cumulative = probabilities.cumsum(axis=1)
    uniforms = rng.random(len(probabilities)) * cumulative[:, -1]
    actions: Actions = (uniforms[:, None] >= cumulative).sum(axis=1)
    return actions.clip(max=cumulative.shape[1] - 1)


def _require_finite(logits: Tensor) -> None:
    """Raise `DivergedError` unless all logits are finite."""
    finite = torch.isfinite(logits)
    if not finite.all():
        raise DivergedError(
            f"policy: expected finite logits, found {logits[~finite][0].item()}; the "
            "weights are not finite, or too large for the precision"
        )


def to_inputs(observations: Any, spec: ObservationSpec) -> Tensor:
    """Observations of an environment as a network's input, sharing their memory.

    Raises:
        PolicyError: they are of another shape or type than specified.
    """
    try:
        return torch.from_numpy(spec.network_input(observations))
    except ObservationError as error:
        raise PolicyError(str(error)) from error
