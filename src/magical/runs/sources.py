"""What a policy may have learned from: the terms of `learned_from` in entries."""

from collections.abc import Iterable, Mapping

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

# Keys of a policy's `record`: fields of `magical.evaluation.Record`.
LEARNED_FROM = "learned_from"
NUM_DEMOS = "num_demos"

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

# Tracks of what learns from Demo demonstrations: each may also use what those before it may.
TRACKS: Mapping[str, str] = {
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


def track_of(names: Iterable[str]) -> str:
    """`P`, `R`, `X` or `B`: the last of `TRACKS` whose source was used; empty for all others.

    The others used another source, such as interaction, or no demonstrations. An object parser is
    declared and does not change the track.
    """
    used = set(names) - {OBJECT_PARSER}
    if DEMONSTRATIONS not in used or not used <= set(TRACKS.values()):
        return ""
    return [name for name, source in TRACKS.items() if source in used][-1]
