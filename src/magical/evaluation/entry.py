"""An evaluated run on disk: `scores.csv` and `entry.json` (docs/protocol.md)."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Self

from msgspec import Meta

from magical import __version__
from magical.envs.action_spec import DISCRETE
from magical.errors import MagicalError, ScoresError
from magical.evaluation.noise import checked_noise
from magical.evaluation.policy import Policy, action_spec_of, observed
from magical.evaluation.protocol import Evaluated, Evaluation
from magical.evaluation.scores import (
    MAX_ROWS,
    RolloutScore,
    check_protocol,
    read_scores,
    write_scores,
)
from magical.files import write_atomically
from magical.messages import quoted
from magical.observe import STATE, Observation, parse_spec
from magical.tasks import parse_horizon
from magical.tasks.horizons import APPENDIX
from magical.untrusted import convert, parse_json, read_json

POLICY = "policy"  # in the details: a run folder relative to the entry's, or a policy's name
THREADS = "threads"  # in the details: CPU threads that the acting network used
UPDATES = "updates"  # in the details of a training run: `done` and `planned`
ACTION_SPACE = "action_space"  # in the details, unless it is the discrete one
TRAINING_SEED = "training_seed"  # in the details of a trained policy, if known
DATE = "date"  # in the details: when the evaluation began, ISO 8601
TRAINING = ("demonstrations", "num_demos", "pretrained_on")  # in the details of some runs
LEARNED_FROM = "learned_from"  # in the details: what the policy was made from
LOOKS = "looks"  # in the details: how often test variants were evaluated before
SCORES_FILE, ENTRY_FILE = "scores.csv", "entry.json"

Text = Annotated[str, Meta(max_length=200)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _EntryFile:
    """What `entry.json` holds."""

    method: Text
    observation: Text = ""
    privileged: bool = False
    horizon: Text = APPENDIX
    nudge: float = 0.0
    seed: Annotated[int, Meta(ge=0)] = 0
    version: Text = ""
    details: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("method", "observation", "version"):
            if not (text := str(getattr(self, name))).isprintable():
                raise ScoresError(f"{name}: expected printable characters, found {quoted(text)}")
        if not self.method.strip():
            raise ScoresError(f"method: expected a name, found {self.method!r}")
        checked_noise(self.nudge)
        parse_horizon(self.horizon)
        if self.observation == STATE:
            object.__setattr__(self, "privileged", True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry(_EntryFile):
    """One training run's evaluation: how it was done, and every rollout's score.

    Attributes:
        method: the method's name in tables.
        scores: the score of every rollout.
        observation: what the policy was shown.
        privileged: whether that was the true state.
        horizon: `appendix`, `published`, or a number of control steps.
        nudge: the largest shift of initial poses, in units and radians.
        seed: which set of fixed seeds.
        version: the version of this package.
        details: demonstrations, training, authors, ...

    Raises:
        ScoresError: unprintable text, or an empty method name.
        InvalidConfigError: an invalid horizon or nudge.
    """

    scores: Sequence[RolloutScore] = field(repr=False)

    @classmethod
    def of(
        cls,
        policy: Policy,
        evaluation: Evaluation,
        *,
        method: str,
        scores: Sequence[RolloutScore] = (),
        details: dict[str, Any],
    ) -> Self:
        """The entry for an evaluation of a policy; raises what the class raises.

        `action_space` is added to the details unless it is the benchmark's discrete one, and
        `updates` for the policy of a training run.
        """
        if (count := len(evaluation.env_ids) * evaluation.rollouts) > MAX_ROWS:
            raise ScoresError(f"expected at most {MAX_ROWS} rollouts in an entry, found {count}")
        task = evaluation.env_ids[0].task_spec
        observation, privileged = observed(policy, evaluation.observation, task)
        actions = action_spec_of(policy)
        if actions is not DISCRETE:
            details = {**details, ACTION_SPACE: actions.name}
        if updates := getattr(policy, "updates", None):
            details = {**details, UPDATES: dict(zip(("done", "planned"), updates, strict=True))}
        return cls(
            method=method,
            scores=scores,
            observation=observation,
            privileged=privileged,
            horizon=evaluation.horizon_name,
            nudge=evaluation.nudge,
            seed=evaluation.seed,
            version=__version__,
            details=details,
        )

    @property
    def evaluated(self) -> Evaluated:
        """How the scores were obtained."""
        return Evaluated(
            env_ids=tuple(dict.fromkeys(row.env_id for row in self.scores)),
            rollouts=1 + max(row.rollout for row in self.scores),
            seed=self.seed,
            observation=self.observation,
            horizon=parse_horizon(self.horizon),
            nudge=self.nudge,
            action_space=str(self.details.get(ACTION_SPACE, DISCRETE.name)),
            privileged=self.privileged,
        )

    def evaluation(self, policy: Policy) -> Evaluation:
        """The evaluation to repeat with the entry's policy."""
        evaluated = self.evaluated
        observation: Observation = None
        # The recorded observation is used only if the policy does not state its own.
        if getattr(policy, "observation", None) is None:
            with suppress(MagicalError):  # not an observation that is known here
                spec = parse_spec(self.observation, evaluated.env_ids[0].task_spec)
                observation = spec if self.observation.startswith("{") else self.observation
        return replace(evaluated, observation=observation)

    def write(self, folder: Path | str) -> None:
        """Write both files.

        If the folder already holds an entry of the same method and policy, its details that this
        one lacks are kept, but not what it learned from, which only this evaluation can know; of
        two numbers of looks the larger counts. Raises what `merged` raises, before anything is
        written.
        """
        text = self.merged(folder)._json(Path(folder) / ENTRY_FILE)
        with write_atomically(Path(folder) / ENTRY_FILE) as file:
            file.write(text.encode())
            file.flush()
            # Within, so that without space on the disk both files stay as they were.
            write_scores(self.scores, Path(folder) / SCORES_FILE)

    def merged(self, folder: Path | str) -> "Entry":
        """The entry that `write` would write, which may be called before scores are computed.

        Raises:
            ScoresError: a field that `read_entry` would refuse, or a damaged entry in the folder.
            TypeError: details that cannot be written as JSON.
        """
        target = Path(folder) / ENTRY_FILE
        kept = self._kept(target)
        numbers = [stated.get(LOOKS) for stated in (kept, self.details)]
        looks = [number for number in numbers if isinstance(number, int)]
        most = {LOOKS: max(looks)} if len(looks) > 1 else {}
        merged = replace(self, details=kept | self.details | most)
        merged._json(target)
        return merged

    @property
    def stated(self) -> dict[str, Any]:
        """All fields except the scores, as plain data: what `entry.json` holds."""
        return {field.name: getattr(self, field.name) for field in fields(_EntryFile)}

    def _json(self, target: Path) -> str:
        text = json.dumps(self.stated, indent=2) + "\n"
        parse_json(text, _EntryFile, str(target), ScoresError)
        return text

    def _kept(self, target: Path) -> dict[str, Any]:
        """What was added to an earlier entry of the same method and policy."""
        if not target.exists():
            return {}
        old = read_json(target, _EntryFile, ScoresError)
        policies = {str(d[POLICY]) for d in (old.details, self.details) if POLICY in d}
        if old.method != self.method or len(policies) > 1:
            return {}
        is_run = "algorithm" in self.details  # whose training was recorded anew
        outdated = {ACTION_SPACE, LEARNED_FROM, *(TRAINING if is_run else ())}
        if old.details.get(LOOKS) == 0:  # true of that evaluation alone
            outdated.add(LOOKS)
        return {name: value for name, value in old.details.items() if name not in outdated}


def read_entry(folder: Path | str) -> Entry:
    """Read what `Entry.write` wrote, and check it against the protocol.

    Raises:
        ScoresError: a file is missing or damaged, or the rollouts are not the protocol's; the
            message says which and what was expected.
    """
    source = Path(folder)
    if not source.is_dir():
        found = "a file" if source.exists() else "nothing"
        raise ScoresError(f"{source}: expected a folder, found {found}")
    for name in (SCORES_FILE, ENTRY_FILE):
        if not (source / name).exists():
            raise ScoresError(
                f"{source}: expected {SCORES_FILE} and {ENTRY_FILE}, found no {name}; "
                f"`magical evaluate POLICY --out {source}` writes them"
            )
    data = read_json(source / ENTRY_FILE, dict[str, Any], ScoresError)
    scores = read_scores(source / SCORES_FILE)
    return make_entry(data, scores, str(source / ENTRY_FILE), str(source / SCORES_FILE))


def make_entry(
    data: dict[str, Any], scores: Sequence[RolloutScore], stated_in: str, scored_in: str
) -> Entry:
    """Make an entry from the data of `entry.json`; raises `ScoresError` naming what is wrong."""
    read = convert(data, _EntryFile, stated_in, ScoresError)
    try:
        check_protocol(scores, read.seed)
    except ScoresError as error:
        raise ScoresError(f"{scored_in}: {error}") from error
    return Entry(scores=scores, **{field.name: getattr(read, field.name) for field in fields(read)})
