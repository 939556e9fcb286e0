"""Figures for one HTML page: plots and learning curves as SVG, rollouts as animated WebP."""

import base64
import html
import importlib.util
import io
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.envs import EnvId
from magical.envs.seeds import evaluation_seed
from magical.envs.vector import MagicalVectorEnv
from magical.errors import MagicalError, RunFolderError
from magical.evaluation import Evaluation, Policy, RolloutScore, by_variant
from magical.evaluation.policy import action_spec_of, observation_for
from magical.evaluation.rollouts import play
from magical.evaluation.statistics import Floats
from magical.files import write_atomically
from magical.render import render_frame
from magical.report.found import Result, by_row
from magical.runs import CURVES, in_words, read_metrics
from magical.scene import View
from magical.scene.constants import CONTROL_RATE
from magical.tasks import get_task

# Okabe and Ito's colours, which are colour-blind safe; then the same colours with other dashes.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")
DASHES = ("-", "--", ":", "-.")
STYLE: Any = {
    "font.size": 11,
    "svg.fonttype": "none",  # text stays text: searchable, and readable by screen readers
    "svg.hashsalt": "magical",  # the same figure gets the same ids
    "text.parse_math": False,  # method names are shown verbatim
}
PANELS = ("loss", "accuracy", "score")  # of a page, if the metrics have them
NOT_PLOTTED = ("step", "environment_steps")
COLUMNS = 4  # of the figure of `save_learning_curves`
SMOOTHING = 50  # rows of metrics in the moving average, at most a tenth of all
MAX_POINTS = 200  # of a curve, roughly: it may have up to twice as many
LARGEST = 1e300  # numbers from here on are not plotted
LAST_FRAME = 1.5  # seconds for which an animation shows its last frame
REEL_SIZE = 120  # pixels across
REEL_FRAMES = 60  # the most in a clip of a reel

LoadPolicy = Callable[[Result], Policy]


@contextmanager
def plotting() -> Iterator[None]:
    """Apply the settings that figures are made and saved with."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # Text stays text and is shown in the reader's fonts, so matplotlib's need not have it.
        warnings.filterwarnings("ignore", "Glyph ", UserWarning)
        yield


def new_figure(height: float, width: float = 6.0) -> Any:
    """An empty figure of a size in inches."""
    # From the `report` extra. `Figure` without pyplot: no window system, no global state.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def svg(figure: Any, name: str, label: str) -> str:
    """A matplotlib figure as an `<svg>` element; call this within `plotting`.

    `name` is a prefix of all ids, unique on the page; `label` says what is shown.
    """
    file = io.StringIO()
    figure.savefig(file, format="svg")
    text = file.getvalue()
    text = text[text.index("<svg") :]
    # Remove the metadata and the style sheet, which would apply to the whole page.
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\b(id=")|(url\(#)|(href="#)', lambda m: f"{m[0]}{name}-", text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(label)}"', 1)


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of the method with this index; distinct for the first 28."""
    dashes = DASHES[index // len(COLOURS) % len(DASHES)]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": dashes}


def tidy(axes: Any) -> None:
    """Add a light grid, and remove the frame at the top and on the right."""
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def curves_by_task(results: Sequence[Result]) -> tuple[dict[str, list[str]], dict[Path, str]]:
    """Learning curves: an SVG for each task and quantity, with a line for each training run.

    Also returns the errors of damaged metrics, by folder. A method's position among all methods
    determines its colour.
    """
    methods = list(dict.fromkeys(result.entry.method for result in results))
    metrics: dict[str, list[tuple[str, Any]]] = {}  # by task, of each run with its method
    damaged: dict[Path, str] = {}
    for folder, result in {result.run: result for result in results if result.run}.items():
        try:
            if rows := read_metrics(folder):
                task = in_words(tuple(result.config.get("tasks") or result.entry.tasks))
                metrics.setdefault(task, []).append((result.entry.method, rows))
        except RunFolderError as error:
            damaged[folder] = str(error)
    figures: dict[str, list[str]] = {}
    for number, (task, runs) in enumerate(metrics.items()):
        for key in PANELS:
            curves = [(methods.index(name), _points(rows, key)) for name, rows in runs]
            if curves := [(index, points) for index, points in curves if points]:
                lines = [(methods[index], line_style(index), points) for index, points in curves]
                drawn = _panel(lines, key, f"curve-{number}-{key}", task)
                figures.setdefault(task, []).append(drawn)
    return figures, damaged


def _panel(
    curves: Sequence[tuple[str, dict[str, Any], Any]], key: str, name: str, task: str
) -> str:
    """One quantity of all runs on a task as SVG, with a legend below."""
    with plotting():
        shown = len({method for method, _, _ in curves})
        figure = new_figure(3.0 + 0.22 * -(-shown // 2), width=4.8)
        axes = figure.subplots()
        lines: dict[str, Any] = {}
        for method, style, points in curves:
            # matplotlib leaves out of legends the names that begin with an underscore.
            label = f"\u200b{method}" if method.startswith("_") else method
            (lines[label],) = axes.plot(*_smooth(points), linewidth=1.3, alpha=0.85, **style)
        axes.set(title=key, xlabel="step")
        if key in ("accuracy", "score"):
            axes.set_ylim(-0.02, 1.02)
        tidy(axes)
        options = {"loc": "outside lower center", "frameon": False, "fontsize": 10}
        figure.legend(lines.values(), list(lines), ncols=min(len(lines), 2), **options)
        return svg(figure, name, f"Learning curves: {key} on {task}")


def _points(rows: Sequence[Mapping[str, Any]], key: str) -> list[tuple[float, float]]:
    """(step, value) where a quantity was measured."""
    pairs = [(row["step"], row[key]) for row in rows if isinstance(row.get(key), int | float)]
    return [(step, y) for step, y in pairs if abs(step) < LARGEST and abs(y) < LARGEST]


def _smooth(points: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    """A trailing moving average: the metrics of single batches are noisy."""
    steps, values = np.array(points, np.float64).T
    width = max(1, min(SMOOTHING, len(points) // 10))
    ends = np.arange(len(points), 0, -max(1, len(points) // MAX_POINTS))[::-1]
    means = [values[max(end - width, 0) : end].mean() for end in ends]
    return steps[ends - 1], np.array(means)


def save_learning_curves(run: Path) -> Path | None:
    """Plot every number in a run's metrics as a PNG in its folder, and return the picture's path.

    `None`, without a picture, if there are no numbers yet or matplotlib is not installed.
    """
    rows = read_metrics(run)
    names = dict.fromkeys(name for row in rows for name in row if name not in NOT_PLOTTED)
    curves = {name: points for name in names if (points := _points(rows, name))}
    if not curves or importlib.util.find_spec("matplotlib") is None:
        return None
    lines = math.ceil(len(curves) / COLUMNS)
    figure = new_figure(2.4 * lines, width=3.6 * COLUMNS)
    for place, (name, points) in enumerate(curves.items(), 1):
        axes = figure.add_subplot(lines, COLUMNS, place)
        axes.plot(*zip(*points, strict=True), linewidth=1.0)
        axes.set_title(name.replace("_", " "), fontsize=10)
        tidy(axes)
    with write_atomically(run / CURVES) as file:
        figure.savefig(file, format="png", dpi=80)
    return run / CURVES


@dataclass(frozen=True, slots=True)
class Clip:
    """One rollout: the allocentric view every few control steps, and the final score."""

    score: float
    frames: NDArray[np.uint8]  # (F, H, W, 3)
    every: int = 1  # control steps between frames

    def webp(self, rate: float = CONTROL_RATE, quality: int = 70, lossless: bool = False) -> bytes:
        """A looping animated WebP, at `rate` control steps per second.

        If `lossless`, `quality` is the compression effort.
        """
        images = [Image.fromarray(frame) for frame in self.frames]
        durations = [round(1000 * self.every / rate)] * (len(images) - 1)
        file = io.BytesIO()
        images[0].save(
            file,
            "WEBP",
            save_all=True,
            append_images=images[1:],
            duration=[*durations, round(1000 * LAST_FRAME)],
            loop=0,
            quality=quality,
            lossless=lossless,
            method=3,
        )
        return file.getvalue()

    def strip(self, count: int = 6) -> NDArray[np.uint8]:
        """`count` frames from first to last, side by side, (H, W * count, 3)."""
        indices = np.linspace(0, len(self.frames) - 1, count).round().astype(int)
        return np.concatenate(list(self.frames[indices]), axis=1)


def record_rollouts(
    policy: Policy,
    evaluation: Evaluation,
    rollouts: Sequence[tuple[EnvId, int]],
    *,
    size: int = 160,
    every: int = 1,
) -> list[Clip]:
    """Run a policy again in some of its evaluation's rollouts, all of one task.

    `rollouts` are the environment and the number of each, `size` the frames' width and height in
    pixels, `every` the control steps between frames; the last step is always shown.
    """
    env_ids = [env_id for env_id, _ in rollouts]
    seeds = [evaluation_seed(number, evaluation.seed) for _, number in rollouts]
    last = env_ids[0].task_spec.resolve_horizon(evaluation.horizon)
    frames = []
    with closing(
        MagicalVectorEnv(
            env_ids,
            workers=0,
            observation=observation_for(policy, evaluation.observation),
            horizon=evaluation.horizon,
            action_space=action_spec_of(policy).name,
        )
    ) as envs:
        for step, (_, infos) in enumerate(play(policy, envs, seeds, evaluation.nudge)):
            if step % every == 0 or step == last:
                states = envs.states()
                frames.append([render_frame(s.scene, s.poses, View.ALLO, size) for s in states])
            scores: Any = infos.get("eval_score")  # at the end
    parts = zip(scores.tolist(), np.swapaxes(frames, 0, 1), strict=True)
    return [Clip(score, own, every) for score, own in parts]


def record_reels(
    results: Sequence[Result], load_policy: LoadPolicy, limit: int
) -> tuple[dict[str, list[tuple[str, str]]], list[str]]:
    """Clips of at most `limit` runs, and notes on what is not shown and why.

    For each row and task the run with the median mean score is chosen. Clips are data URIs with
    captions, by the row and the task in words.
    """
    chosen: dict[str, tuple[Result, str]] = {}  # by title: the run and the task
    for row, runs in by_row(results, attrgetter("entry")).items():
        means: dict[str, list[tuple[float, int]]] = {}  # by task: the runs' means and numbers
        for number, run in enumerate(runs):
            for task, cells in by_variant(run.entry.scores).items():
                scores = [rollout.score for cell in cells.values() for rollout in cell]
                means.setdefault(task, []).append((float(np.mean(scores)), number))
        for task, of_task in means.items():
            _, median = sorted(of_task)[(len(of_task) - 1) // 2]
            chosen[f"{row} on {task}"] = runs[median], task
    reels, notes = dict[str, list[tuple[str, str]]](), list[str]()
    for title, (result, task) in list(chosen.items())[:limit]:
        try:
            reels[title] = list(_clips(result, load_policy(result), task))
        except (MagicalError, OSError) as error:
            notes.append(f"{title}: {error}")
    if left := list(chosen)[limit:]:
        notes.append(f"Not shown (--clips {limit} sets the limit): {', '.join(left)}")
    return reels, notes


def _clips(result: Result, policy: Policy, task: str) -> Iterator[tuple[str, str]]:
    """The best, median and worst rollouts on a task's variants as data URIs, with captions."""
    evaluation = result.entry.evaluation(policy)
    named = [
        (f"{variant}, {name}", row)
        for variant, cell in by_variant(result.entry.scores)[task].items()
        for name, row in extremes(cell)
    ]
    every = -(-get_task(task).resolve_horizon(evaluation.horizon) // REEL_FRAMES)
    rollouts = [(row.env_id, row.rollout) for _, row in named]
    clips = record_rollouts(policy, evaluation, rollouts, size=REEL_SIZE, every=every)
    for (name, row), clip in zip(named, clips, strict=True):
        same = abs(clip.score - row.score) < 1e-9
        caption = f"{name}: {clip.score:.2f}" + ("" if same else f" (recorded: {row.score:.2f})")
        data = base64.b64encode(clip.webp(quality=55)).decode()
        yield f"data:image/webp;base64,{data}", caption


def extremes(scores: Sequence[RolloutScore]) -> list[tuple[str, RolloutScore]]:
    """The best, the median and the worst rollout; only the first if all have the same score.

    Among rollouts with the same score, earlier ones count as worse; of two medians, the lower one
    is taken. Of two rollouts, the worst is the median.
    """
    ordered = sorted(scores, key=lambda row: (row.score, row.rollout))
    if ordered[0].score == ordered[-1].score:
        return [("every rollout", ordered[0])]
    median = ordered[(len(ordered) - 1) // 2]
    named = [("best", ordered[-1]), ("median", median), ("worst", ordered[0])]
    return named[: len(ordered)]
