"""The best, the median and the worst rollout of evaluated runs, re-run and recorded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from magical.errors import MagicalError
from magical.evaluation import Entry, Policy, RolloutScore, by_variant
from magical.report.figures.clips import Clip, data_uri, encoded, record_rollouts
from magical.report.found.rows import by_row
from magical.report.found.search import Result
from magical.tasks import get_task
from magical.tasks.axes import short_variant

SIZE = 120  # pixels across
MAX_FRAMES = 60  # in a clip
QUALITY = 55  # of WebP compression, 0 to 100
MAX_BYTES = 9_000_000  # of all clips on a page, encoded

LoadPolicy = Callable[[Result], Policy]


@dataclass(frozen=True, slots=True)
class ShownClip:
    """An animation with its caption."""

    uri: str
    caption: str


@dataclass(frozen=True, slots=True)
class Reel:
    """Clips of one run's rollouts on a task: by variant, from best to worst."""

    title: str
    clips: Sequence[ShownClip]
    shown: str = ""  # what the policy was shown, as a data URI
    shown_note: str = ""


def record_reels(
    results: Sequence[Result], load_policy: LoadPolicy, limit: int
) -> tuple[list[Reel], list[str]]:
    """Reels of at most `limit` runs: for each method and task, the run with the median mean score.

    Args:
        results: evaluated runs.
        load_policy: loads a run's policy; may raise `MagicalError`.
        limit: the maximum number of reels.

    Returns:
        The reels, and notes on what is not shown and why.
    """
    reels, notes, room = [], [], MAX_BYTES
    chosen = _median_runs(results)
    for row, task, result in chosen[:limit]:
        title = f"{row} on {task}"
        try:
            reel = _record(load_policy(result), result, task, title)
        except (MagicalError, OSError) as error:
            notes.append(f"{title}: {error}")
            continue
        size = sum(len(clip.uri) for clip in reel.clips) + len(reel.shown)
        if size > room:
            notes.append(f"{title}: left out to keep the page small")
            continue
        room -= size
        reels.append(reel)
    if chosen[limit:]:
        names = ", ".join(f"{row} on {task}" for row, task, _ in chosen[limit:])
        notes.append(f"Not shown (--clips {limit} sets the limit): {names}")
    return reels, notes


def extremes(scores: Sequence[RolloutScore]) -> list[tuple[str, RolloutScore]]:
    """The best, the median and the worst rollout; only the first if all have the same score.

    Among rollouts with the same score, earlier ones count as worse; of two medians, the lower one
    is taken.
    """
    ordered = sorted(scores, key=lambda row: (row.score, row.rollout))
    if ordered[0].score == ordered[-1].score:
        return [("all", min(scores, key=lambda row: row.rollout))]
    median = ordered[(len(ordered) - 1) // 2]
    named = [("best", ordered[-1]), ("median", median), ("worst", ordered[0])]
    return [pair for i, pair in enumerate(named) if pair[1] not in [row for _, row in named[:i]]]


def _median_runs(results: Sequence[Result]) -> list[tuple[str, str, Result]]:
    """(row, task, run): for each row and task, the run with the median mean score."""
    groups: dict[tuple[str, str], list[tuple[float, int]]] = {}
    ordered = [
        (label, r) for label, row in by_row(results, attrgetter("entry")).items() for r in row
    ]
    for number, (label, result) in enumerate(ordered):
        for task, cells in by_variant(result.entry.scores).items():
            mean = float(np.mean([row.score for cell in cells.values() for row in cell]))
            groups.setdefault((label, task), []).append((mean, number))
    return [
        (*key, ordered[sorted(runs)[(len(runs) - 1) // 2][1]][1]) for key, runs in groups.items()
    ]


def _record(policy: Policy, result: Result, task: str, title: str) -> Reel:
    entry = result.entry
    evaluation = entry.evaluation(policy)
    steps = get_task(task).resolve_horizon(evaluation.horizon)
    named = [
        (short_variant(variant), name, row)
        for variant, cell in by_variant(entry.scores)[task].items()
        for name, row in extremes(cell)
    ]
    rollouts = [(row.env_id, row.rollout) for _, _, row in named]
    every = -(-steps // MAX_FRAMES)
    clips = record_rollouts(policy, evaluation, rollouts, size=SIZE, every=every)
    shown = [
        ShownClip(
            data_uri(clip.webp(quality=QUALITY), "image/webp"), _caption(variant, name, row, clip)
        )
        for (variant, name, row), clip in zip(named, clips, strict=True)
    ]
    return Reel(title, shown, *_what_was_shown(clips[0].shown, entry))


def _caption(variant: str, name: str, row: RolloutScore, clip: Clip) -> str:
    """A caption such as `Layout, best: 1.00`; says so if the score is not the recorded one."""
    text = f"{variant}, {'every rollout' if name == 'all' else name}: {clip.score:.2f}"
    same = abs(clip.score - row.score) < 1e-9
    return text if same else f"{text} (recorded: {row.score:.2f})"


def _what_was_shown(picture: NDArray[np.uint8] | None, entry: Entry) -> tuple[str, str]:
    """An image of one observation as a data URI, and a caption."""
    if picture is None:
        return "", f"The policy was shown {entry.observation or 'no image'}, which is not an image."
    caption = f"What the policy was shown halfway through the first rollout ({entry.observation})"
    return data_uri(encoded(picture, "PNG", optimize=True), "image/png"), caption
