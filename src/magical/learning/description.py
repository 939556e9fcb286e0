"""What an entry's details say about a trained policy."""

from typing import Any

from magical.learning.config import Config, DemonstrationSettings
from magical.runs.sources import LEARNED_FROM


def training_details(config: Config) -> dict[str, Any]:
    """How a policy was trained, for `details` of `entry.json` (docs/protocol.md)."""
    details: dict[str, Any] = {
        "algorithm": config.algorithm,
        "training_seed": config.seed,
        LEARNED_FROM: list(config.learned_from),
    }
    demonstrations = config.part(DemonstrationSettings)
    if demonstrations:
        details["demonstrations"] = f"{demonstrations.num_demos} of each task"
    return details
