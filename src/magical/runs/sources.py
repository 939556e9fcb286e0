"""What an entry may have learned from: the terms of `learned_from` in its details."""

from collections.abc import Iterable, Mapping
from typing import Any

from magical.errors import UnknownNameError
from magical.messages import quoted

DEMONSTRATIONS = "demonstrations"
RENDERED_STATES = "rendered states"
SIMULATOR = "simulator"
INTERACTION = "interaction"
SCORE = "score"
EXPERT_LABELS = "expert labels"
TEST_VARIANTS = "test variants"
EXTRA_DATA = "extra data"
OBJECT_PARSER = "object parser"
BENCHMARK_PRIOR = "benchmark prior"

# Fields of an entry's details.
LEARNED_FROM = "learned_from"
NUM_DEMOS = "num_demos"  # demonstrations of each task that a policy learned from
PRETRAINED_ON = "pretrained_on"  # the tasks that a network was pre-trained on

SOURCES: Mapping[str, str] = {
    DEMONSTRATIONS: "demonstrations of the Demo variant",
    RENDERED_STATES: "stored Demo states rendered with other colours, shapes or walls",
    SIMULATOR: "the simulator outside Demo, without scores, or pre-training on it",
    INTERACTION: "episodes in the Demo variant, without their scores",
    SCORE: "scores of episodes in the Demo variant",
    EXPERT_LABELS: "an expert asked for actions in states that the learner visits",
    TEST_VARIANTS: "test variants, seen before the final evaluation",
    EXTRA_DATA: "data from elsewhere, such as a pre-trained network",
    OBJECT_PARSER: "a parser made for the known palette, or fitted on rendered scenes",
    BENCHMARK_PRIOR: "features or penalties chosen by those who know the tasks, or a part "
    "fitted on scenes of test variants",
}

# Classes of what learns from Demo demonstrations: each may also use what those before it may.
CLASSES: Mapping[str, str] = {
    "P": DEMONSTRATIONS,
    "R": RENDERED_STATES,
    "X": SIMULATOR,
    "B": BENCHMARK_PRIOR,
}

# What learners that use the object parser declare. Its constants were fitted on scenes of TestAll,
# and a part fitted on scenes of test variants is a prior made for the benchmark (docs/protocol.md).
PARSER_SOURCES = (OBJECT_PARSER, BENCHMARK_PRIOR)


def parse_source(name: str) -> str:
    """The name of a source, unchanged; raises `UnknownNameError` if it is not in `SOURCES`."""
    if name not in SOURCES:
        known = ", ".join(SOURCES)
        raise UnknownNameError(
            f"{quoted(name)} is not a source of learning; expected some of: {known}"
        )
    return name


def learning_class(names: Iterable[str]) -> str:
    """`P`, `R`, `X` or `B`: the last of `CLASSES` whose source was used; empty for all others.

    The others used another source, such as interaction, or no demonstrations. An object parser is
    declared and does not change the class.
    """
    used = set(names) - {OBJECT_PARSER}
    if DEMONSTRATIONS not in used or not used <= set(CLASSES.values()):
        return ""
    return [name for name, source in CLASSES.items() if source in used][-1]


def learned_from(details: Mapping[str, Any]) -> tuple[str, ...]:
    """What an entry's details say it learned from, in the order of `SOURCES`.

    Raises:
        ValueError: they do not state it, or name something that is not in `SOURCES`.
    """
    stated = details.get(LEARNED_FROM)
    names = stated if isinstance(stated, list) else None
    if names is None or any(name not in SOURCES for name in map(str, names)):
        found = "none; `evaluate --learned-from` states it" if stated is None else quoted(stated)
        raise ValueError(
            f"expected {LEARNED_FROM} in the details, a list of some of: {', '.join(SOURCES)}; "
            f"found {found}"
        )
    return tuple(name for name in SOURCES if name in names)
