"""How sure a belief is of its first move in scenes that were not demonstrated."""

import numpy as np

from magical.learning.intent.acting import Intention
from magical.learning.intent.posterior import Belief
from magical.scene import Poses
from magical.tasks import get_task


def confidence_by_variant(belief: Belief, task: str, scenes: int) -> dict[str, float]:
    """The mean over sampled scenes of each of a task's variants; see `Intention.confidence`.

    The same scenes each time.
    """
    found = {}
    for variant in get_task(task).variants:
        rng = np.random.default_rng(0)
        sampled = [get_task(task).sample(variant, rng)[0] for _ in range(scenes)]
        each = [Intention(belief, scene).confidence(Poses.at_rest(scene)) for scene in sampled]
        found[variant] = float(np.mean(each))
    return found
