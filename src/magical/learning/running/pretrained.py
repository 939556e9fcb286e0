"""Networks initialised with the trunk of another run."""

from pathlib import Path

from magical.errors import InvalidConfigError
from magical.learning.algorithms import read_config
from magical.learning.config import Config
from magical.learning.models import Trunk
from magical.learning.running.checkpoints import restoring
from magical.learning.running.loading import load_policy
from magical.learning.running.run import Run
from magical.runs.folder import CHECKPOINT
from magical.runs.sources import PRETRAINED_ON


def load_pretrained(trunk: Trunk, config: Config, init_from: str, run: Run) -> None:
    """Load the trunk of the run `init_from`, and record the tasks that it learned in `run.json`.

    Raises:
        InvalidConfigError: no run of bc from its own initialisation, or of another observation
            or conventions.
        RunFolderError, CheckpointError: a damaged run, or one of another network.
    """
    folder = Path(init_from)
    before = read_config(folder)
    if before.algorithm != "bc" or before.to_dict()["init_from"]:
        raise InvalidConfigError(
            f"init_from: expected a run of bc that was itself not fine-tuned, found {folder}"
        )
    if before.observation_spec != config.observation_spec:
        raise InvalidConfigError(
            f"init_from: expected a run with the observation {config.observation}, found "
            f"{before.observation} in {folder}"
        )
    if before.to_dict()["conventions"] != config.to_dict()["conventions"]:
        raise InvalidConfigError(
            f"init_from: expected a run with the same conventions, found others in {folder}"
        )
    network = load_policy(folder, "cpu").network
    with restoring(folder / CHECKPOINT):
        trunk.load_state_dict(network.get_submodule("trunk").state_dict())
    run.describe(**{PRETRAINED_ON: list(before.tasks)})
