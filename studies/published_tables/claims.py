"""The paper's conclusions as contrasts of methods: published, and ours."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from magical.envs import EnvId
from magical.evaluation.published import published_table
from magical.evaluation.statistics import CONFIDENCE, ROUNDING, Interval, contrast, mean
from magical.tasks.axes import short_variant
from studies.published_tables.rows import CODE, MethodRuns, reproduced_row
from studies.published_tables.scale import published_contrast

DEMO, TESTS = "Demo", "test variants"
PARTS = (DEMO, TESTS)
BC, NO_AUG, NO_TRANS_ROT = "BC (ST)", "BC (ST, no aug.)", "BC (ST, no trans./rot. aug.)"
GAIL, AL = "GAIL (ST)", "AL (ST)"
ALLO, MULTI, LONGER = "BC (ST, allo.)", "BC (MT)", "four times the batches"
MORE_STEPS = "four times the environment steps"
OPTIMISER = "published optimiser"
PAPER, SCRIPTED = "BC (ST), paper settings", "BC (ST), scripted experts"
PERTURBED, MIXED = "BC (ST), perturbed experts", "BC (ST), human and scripted"
HUNDRED = "BC (ST), 100 perturbed experts"


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement that a weighted sum of methods' mean scores is above 0.

    Attributes:
        text: the statement.
        weights: of the methods.
    """

    text: str
    weights: Mapping[str, float]

    @property
    def formula(self) -> str:
        """Such as `BC (ST) − BC (ST, no aug.)`."""
        terms = [
            f"{'−' if weight < 0 else '+'} {f'{abs(weight):g} x ' * (abs(weight) != 1)}{method}"
            for method, weight in self.weights.items()
        ]
        return " ".join(terms).removeprefix("+ ")


def _claim(text: str, better: str, worse: str) -> Claim:
    return Claim(text, {better: 1.0, worse: -1.0})


CLAIMS = (
    _claim("augmentation helps BC", BC, NO_AUG),
    _claim(
        "augmentation helps BC, with the published code's settings",
        f"{BC}, {CODE}",
        f"{NO_AUG}, {CODE}",
    ),
    _claim("augmentation helps GAIL", GAIL, "GAIL (ST, no aug.)"),
    _claim("translation and rotation help", BC, NO_TRANS_ROT),
    Claim(
        "translation and rotation matter more than the other augmentations",
        {BC: 1.0, NO_AUG: 1.0, NO_TRANS_ROT: -2.0},
    ),
    _claim("the egocentric view is better than the allocentric one, for BC", BC, ALLO),
    _claim("multi-task training helps BC", MULTI, BC),
    _claim("GAIL is better than BC", GAIL, BC),
    _claim(
        "GAIL is better than BC, with the published code's settings",
        f"{GAIL}, {CODE}",
        f"{BC}, {CODE}",
    ),
    _claim("GAIL is better than WGAIL-GP", GAIL, "WGAIL-GP (ST)"),
    _claim("GAIL is better than apprenticeship learning", GAIL, AL),
)
# What the published tables do not have, and our rows do.
VARIATIONS = (
    _claim("paper settings instead of quick ones", PAPER, BC),
    _claim("scripted experts instead of humans", SCRIPTED, BC),
    _claim("perturbed experts instead of humans", PERTURBED, BC),
    _claim("perturbed experts instead of unperturbed ones", PERTURBED, SCRIPTED),
    _claim("a hundred perturbed demonstrations instead of ten", HUNDRED, PERTURBED),
    _claim("human and scripted together instead of human alone", MIXED, BC),
    _claim("human and scripted together instead of scripted alone", MIXED, SCRIPTED),
    _claim(
        "four times the batches of `quick`, without augmentation", f"{NO_AUG}, {LONGER}", NO_AUG
    ),
    _claim(
        "four times the batches of `quick`, with the allocentric view", f"{ALLO}, {LONGER}", ALLO
    ),
    _claim("four times the batches of `quick`, multi-task", f"{MULTI}, {LONGER}", MULTI),
    _claim(
        "four times the environment steps of `quick`, for GAIL",
        f"{GAIL}, {MORE_STEPS}",
        GAIL,
    ),
    _claim(
        "the published optimiser and number of batches, without augmentation",
        f"{NO_AUG}, {OPTIMISER}",
        NO_AUG,
    ),
    _claim(
        "the published optimiser and number of batches, with augmentation",
        f"{BC}, {OPTIMISER}",
        BC,
    ),
    _claim(
        "augmentation, with the published optimiser and number of batches",
        f"{BC}, {OPTIMISER}",
        f"{NO_AUG}, {OPTIMISER}",
    ),
    _claim(
        "colour jitter, with the published optimiser and number of batches",
        f"{BC}, {OPTIMISER} and colour jitter",
        f"{BC}, {OPTIMISER}",
    ),
    _claim(
        "the published code's other settings, with its optimiser, batches and colour jitter",
        f"{BC}, {CODE}",
        f"{BC}, {OPTIMISER} and colour jitter",
    ),
    Claim(
        "augmentation, with the published code's settings rather than those of `quick`",
        {f"{BC}, {CODE}": 1.0, f"{NO_AUG}, {CODE}": -1.0, BC: -1.0, NO_AUG: 1.0},
    ),
    _claim(
        "how the published code scales pixels and initialises the last layer",
        f"{NO_AUG}, published pixels and last layer",
        NO_AUG,
    ),
    _claim(
        "the published bound on w, for apprenticeship learning", f"{AL}, published bound on w", AL
    ),
    *(
        _claim(
            f"{text}, for GAIL with {MORE_STEPS}",
            f"{GAIL}, {change}",
            f"{GAIL}, {MORE_STEPS}",
        )
        for text, change in (
            ("some of the published settings of PPO", "published PPO"),
            (
                "the published learning rate of the discriminator",
                "published learning rate of the discriminator",
            ),
            ("a second linear layer", "a second linear layer"),
            (
                "the published code's conventions and initialisation",
                "published initialisation and pixels",
            ),
        )
    ),
)


@dataclass(frozen=True, slots=True)
class Finding:
    """What becomes of a claim on a part of the environments.

    Attributes:
        claim: what is stated.
        part: of the environments: `Demo`, `test variants`, or one variant such as `Jitter`.
        tasks: on which ours was computed; none where a method has not been run.
        published: over all tasks; `None` where a method reproduces no published row, or two the
            same one.
        same: published, over our tasks; `None` as well where there are none.
        ours: `None` where there are none.
    """

    claim: Claim
    part: str
    tasks: tuple[str, ...]
    published: Interval | None
    same: Interval | None
    ours: Interval | None

    @property
    def verdict(self) -> str:
        """What ours says of the claim, and whether the published tables say the same."""
        if self.ours is None:
            return "not run"
        ours = verdict(self.ours)
        if self.same is None or math.isnan(self.ours.low):
            return ours
        theirs = verdict(self.same)
        return f"{ours}, as published" if ours == theirs else f"{ours}; published: {theirs}"


def verdict(interval: Interval) -> str:
    """What an interval says of the claim that a value is above 0."""
    if math.isnan(interval.low):
        return "open: too few runs"
    if interval.low > 0.0:
        return "holds"
    return "the opposite holds" if interval.high < 0.0 else "open"


def find(
    claims: Iterable[Claim],
    rows: Sequence[MethodRuns],
    parts: Sequence[str] = PARTS,
    confidence: float = CONFIDENCE,
) -> list[Finding]:
    """Every claim on every part: `Demo`, `test variants`, or one variant such as `Jitter`."""
    known = {row.method: row for row in rows}
    return [_finding(claim, part, known, confidence) for claim in claims for part in parts]


def find_together(
    claims: Iterable[Claim], rows: Sequence[MethodRuns], parts: Sequence[str] = PARTS
) -> list[Finding]:
    """As `find`, with a confidence that all tested findings have together (Bonferroni's)."""
    claims = list(claims)
    tested = sum(finding.ours is not None for finding in find(claims, rows, parts))
    return find(claims, rows, parts, 1.0 - (1.0 - CONFIDENCE) / max(tested, 1))


def _finding(claim: Claim, part: str, rows: Mapping[str, MethodRuns], confidence: float) -> Finding:
    cells = {(task, variant) for task, _, variant in published_table() if _is_in(variant, part)}
    published = same = ours = None
    theirs = {reproduced_row(name): weight for name, weight in claim.weights.items()}
    is_published = "" not in theirs and len(theirs) == len(claim.weights)
    if is_published:
        published = published_contrast(theirs, sorted(cells), confidence)
    env_ids = _shared([rows[name] for name in claim.weights if name in rows], part)
    if env_ids and claim.weights.keys() <= rows.keys():
        tables = [rows[name].on(env_ids) for name in claim.weights]
        ours = contrast(tables, list(claim.weights.values()), confidence)
        if is_published:
            shared = [(i.task, i.variant) for i in env_ids]
            same = published_contrast(theirs, shared, confidence)
    tasks = tuple(dict.fromkeys(i.task for i in env_ids)) if ours is not None else ()
    return Finding(claim, part, tasks, published, same, ours)


def _is_in(variant: str, part: str) -> bool:
    return variant != DEMO if part == TESTS else short_variant(variant) == part


def _shared(rows: Sequence[MethodRuns], part: str) -> list[EnvId]:
    """The environments of a part that all rows have."""
    first = rows[0].env_ids if rows else ()
    return [i for i in first if _is_in(i.variant, part) and all(i in row.env_ids for row in rows)]


@dataclass(frozen=True, slots=True)
class Place:
    """A method's mean over some environments, published and ours, with its ranks from 1."""

    method: str
    published: Interval
    ours: Interval
    published_rank: int
    rank: int


def order(rows: Sequence[MethodRuns], part: str) -> tuple[list[str], list[Place]]:
    """The methods that reproduce a published one, by our rank, and before them their tasks.

    Means are over the environments of a part that all have.
    """
    rows = [row for row in rows if reproduced_row(row.method)]
    env_ids = _shared(rows, part)
    cells = [(env_id.task, env_id.variant) for env_id in env_ids]
    if not env_ids:
        return [], []
    theirs = {row.method: published_contrast({row.published: 1.0}, cells) for row in rows}
    ours = {row.method: mean(row.on(env_ids)) for row in rows}
    places = [
        Place(name, theirs[name], ours[name], _rank(name, theirs), _rank(name, ours))
        for name in theirs
    ]
    tasks = list(dict.fromkeys(env_id.task for env_id in env_ids))
    return tasks, sorted(places, key=lambda place: place.rank)


def _rank(name: str, means: Mapping[str, Interval]) -> int:
    return 1 + sum(other.value > means[name].value + ROUNDING for other in means.values())
