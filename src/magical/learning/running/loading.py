"""Loading policies from run folders."""

from pathlib import Path

from magical.learning.algorithms import find_algorithm, read_config
from magical.learning.policy import NetworkPolicy, TrainedPolicy
from magical.learning.running.checkpoints import load_newest_checkpoint, restoring
from magical.learning.running.devices import Compute, choose_device, read_compute
from magical.runs.folder import CHECKPOINT, RECORD, read_json


def load_policy(run: Path | str, device: str = "auto", greedy: bool = False) -> TrainedPolicy:
    """Load the policy from the newest checkpoint of a run folder.

    Args:
        run: the run folder.
        device: `auto`, `cpu` or `cuda`.
        greedy: take the most probable action instead of sampling. Has no effect on policies with
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
    state = load_newest_checkpoint(folder)
    with restoring(folder / CHECKPOINT):
        network.load_state_dict(state["policy"])
    recorded = read_compute(read_json(folder / RECORD), folder)
    precision = recorded.precision if recorded and chosen == recorded.device else "float32"
    kind = algorithm.policy or NetworkPolicy
    return kind(network.to(chosen), config, Compute(chosen, precision), greedy)
