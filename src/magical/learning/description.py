"""What an entry's details say about a trained policy."""

from typing import Any

from magical.learning.config import Config, ImitationConfig
from magical.runs.sources import LEARNED_FROM


def training_details(config: Config) -> dict[str, Any]:
    """How a policy was trained, for `details` of `entry.json` (docs/protocol.md)."""
    details: dict[str, Any] = {
        "algorithm": config.algorithm,
        "training_seed": config.seed,
        LEARNED_FROM: list(config.learned_from),
    }
    if isinstance(config, ImitationConfig):
        details["demonstrations"] = f"{config.num_demos} of each task"
    return details
