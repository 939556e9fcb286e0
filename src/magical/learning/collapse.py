"""Signs that a run has collapsed, told once they have lasted."""

import math
from collections.abc import Mapping

PATIENCE = 50  # updates in a row
CHANCE = 0.5
NEAR_CHANCE = 0.05  # a discriminator's accuracy this close to chance is at chance


class Watch:
    """Counts for how many updates in a row each sign has been seen."""

    def __init__(self, seen: Mapping[str, int] | None = None) -> None:
        self.seen = dict(seen or {})

    def warnings(self, metrics: Mapping[str, float | str], one_action: bool) -> str:
        """What is wrong after another update, or an empty text."""
        accuracy = metrics.get("discriminator_accuracy")
        signs = {"one action": one_action}
        if isinstance(accuracy, float):
            signs["discriminator at chance"] = abs(accuracy - CHANCE) <= NEAR_CHANCE
            signs["discriminator always right"] = accuracy == 1.0
        self.seen = {sign: self.seen.get(sign, 0) + 1 for sign, is_so in signs.items() if is_so}
        found = [f"{sign} for {n} updates" for sign, n in self.seen.items() if n >= PATIENCE]
        numbers = [value for value in metrics.values() if not isinstance(value, str)]
        if not all(map(math.isfinite, numbers)):
            found.insert(0, "not finite")
        return ", ".join(found)
