"""A page for each task and for each environment, from the registry and the entries."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magical.compiled import digest_of
from magical.envs import all_env_ids, parse_env_id
from magical.evaluation import by_variant, published_methods, published_score, published_tasks
from magical.report.found import Result
from magical.report.leaderboard import WITH_PRIOR, Leaderboard
from magical.scene.constants import CONTROL_RATE
from magical.tasks import CHANGES, TASKS, VARIANTS, Task
from magical.tasks.axes import short_variant
from tools.readme_tables import table
from tools.site.previews import SIZE, EnvPreview, make_previews

FOLDER = "environments"
EXPERT = "expert"
ROOMS = ("tasks", "scene", "physics", "render", "experts", "envs", "demos", "report")
STILL, MOVING = ".still.webp", ".webp"
NOTE = (
    "Means over training runs, and their standard deviation where there are several. Published "
    "scores are by the [published code's rule and horizon]"
    "(../../specification.md#9-where-the-published-code-scores-differently), all others by the "
    "[protocol](../../protocol.md). The best entries are those with the highest TestAll score in "
    "this task on the [leaderboard](../../leaderboard.md), with a prior made for the benchmark "
    "(track B) and without; the expert sees the true state."
)


@dataclass(frozen=True)
class Row:
    method: str
    scores: Mapping[str, str]  # by short variant name, as text

    def cells(self, variants: Sequence[str]) -> list[str]:
        return [self.method, *(self.scores.get(short_variant(name), "") for name in variants)]


def pages(root: Path, cache: Path, ranked: Leaderboard) -> dict[str, str | bytes]:
    """Every page and picture, by its path in the site."""
    folder = previews(root, cache)
    standings = {board.name: board.standings for board in ranked.boards}
    made: dict[str, str | bytes] = {f"{FOLDER}/index.md": index()}
    for task in TASKS.values():
        parts = (standings.get(task.name + which, ()) for which in ("", WITH_PRIOR))
        best = [row.method for part in parts for row in part if row.rank == 1]
        rows = [
            *_evaluated(task, ranked.accepted, dict.fromkeys([EXPERT, *best])),
            *_published(task),
        ]
        place = f"{FOLDER}/{task.name}"
        made[f"{place}/index.md"] = task_page(task, rows)
        for variant in task.variants:
            kept = f"{task.name}-{variant}"
            score = (folder / f"{kept}.txt").read_text()
            made[f"{place}/{variant}.md"] = environment_page(task, variant, rows, score)
            for suffix in (STILL, MOVING):
                made[f"{place}/{variant}{suffix}"] = (folder / f"{kept}{suffix}").read_bytes()
    return made


def navigation() -> list[dict[str, object]]:
    """The pages' navigation for MkDocs: an overview, then a section for each task."""
    sections: list[dict[str, object]] = [{"Overview": f"{FOLDER}/index.md"}]
    for task in TASKS.values():
        inner = [{short_variant(v): f"{FOLDER}/{task.name}/{v}.md"} for v in task.variants]
        sections.append({task.name: [f"{FOLDER}/{task.name}/index.md", *inner]})
    return sections


def previews(root: Path, cache: Path) -> Path:
    """The folder with the pictures of every environment, made again if the code has changed."""
    rooms = (root / "src/magical" / room for room in ROOMS)
    folder = cache / digest_of(root / "tools/site", *rooms)[:16]
    if not (folder / "complete").exists():
        folder.mkdir(parents=True, exist_ok=True)
        for preview in make_previews([*map(parse_env_id, all_env_ids())]):
            _keep(preview, folder)
        (folder / "complete").touch()
    return folder


def _keep(preview: EnvPreview, folder: Path) -> None:
    (folder / f"{preview.name}{STILL}").write_bytes(preview.still)
    (folder / f"{preview.name}{MOVING}").write_bytes(preview.animation)
    (folder / f"{preview.name}.txt").write_text(f"{preview.scene}\n{preview.score:.2f}")


def index() -> str:
    """The overview: all tasks, their pictures and variants."""
    count = sum(len(task.variants) for task in TASKS.values())
    cards = "\n".join(
        f'<a href="{task.name}/index.html">{picture(f"{task.name}/Demo", task.summary)}'
        f"<strong>{task.name}</strong> {task.summary}</a>"
        for task in TASKS.values()
    )
    rows = (
        [f"[{task.name}]({task.name}/index.md)", task.horizon, *_marks(task)]
        for task in TASKS.values()
    )
    header = ["Task", "Horizon", *map(short_variant, VARIANTS)]
    return (
        f"# Environments\n\n{len(TASKS)} tasks, each with a Demo variant to learn from and test "
        f"variants that change certain aspects of it: {count} environments. An id is "
        "`magical/<Task>-<Variant>[-<Preset>]-v0`; a preset names [what is observed]"
        "(../environments.md).\n\n"
        f'<div class="tasks">\n{cards}\n</div>\n\n{table(header, rows)}\n'
    )


def _marks(task: Task) -> Iterator[str]:
    for name in VARIANTS:
        link = f"[✓]({task.name}/{name}.md)"
        yield link if name in task.variants else ""


def task_page(task: Task, rows: Sequence[Row]) -> str:
    """A task's page: what to do, the score rule, what each variant changes, scores."""
    varies = table(
        ("Variant", "Changes"),
        ((f"[{name}]({name}.md)", describe_changes(task, name)) for name in task.variants),
    )
    scores = table(
        ("", *map(short_variant, task.variants)), (row.cells(task.variants) for row in rows)
    )
    return (
        f"# {task.name}\n\n{task.summary}\n\n"
        f"{picture('Demo', f'The expert in {task.name} Demo')}\n"
        f"{picture('TestAll', f'The expert in {task.name} TestAll')}\n\n"
        "The scripted expert in Demo and in TestAll, at twice the control rate.\n\n"
        f"## Score\n\n{scoring_rule(task)}\n\n"
        f"**Horizon**: {_horizon(task)}\n\n"
        f"## Variants\n\n{varies}\n\n"
        f"## Scores\n\n{scores}\n\n{NOTE}\n"
    )


def environment_page(task: Task, variant: str, rows: Sequence[Row], kept: str) -> str:
    """An environment's page: the expert's rollout, what varies, horizon, score rule, scores."""
    name = f"{task.name}-{variant}"
    scene, score = kept.split("\n")
    changes = describe_changes(task, variant)
    scores = table(
        ("Method", "Score"),
        (
            (row.method, row.scores[short])
            for row in rows
            if (short := short_variant(variant)) in row.scores
        ),
    )
    return (
        f"# {name}\n\n{task.summary}\n\n"
        f"{picture(variant, f'The expert in {name}: {scene}')}\n\n"
        f"The scene of `reset(seed=0)` ({scene}), attempted by the scripted expert, "
        f"which scores {score} here.\n\n"
        "```python\nimport gymnasium\nimport magical\n\n"
        f'env = gymnasium.make("magical/{name}-v0")\n```\n\n'
        f"**What varies**: {changes}\n\n"
        f"**Horizon**: {_horizon(task)}\n\n"
        f"**Score** ([the task](index.md) and its other variants):\n\n"
        f"{scoring_rule(task)}\n\n"
        f"## Scores\n\n{scores}\n\n{NOTE}\n"
    )


def scoring_rule(task: Task) -> str:
    """A task's scoring rule in Markdown; paragraphs that are indented are formulas."""
    cited = "[specification](../../specification.md)"
    parts = []
    for paragraph in task.rule.split("\n\n"):
        text = " ".join(paragraph.replace("`", "").split())
        is_formula = paragraph.startswith(" ")
        text = text if is_formula else text.replace("docs/specification.md", cited)
        parts.append(f"```text\n{text}\n```" if is_formula else text)
    return "\n\n".join(parts)


def describe_changes(task: Task, variant: str) -> str:
    """What a variant changes: the description of its only axis, or the names of its axes."""
    axes = [axis for axis in CHANGES if axis in task.axes_of(variant)]
    if not axes:
        return "the scene of the demonstrations"
    names = ", ".join(str(axis.name).lower() for axis in axes)
    return CHANGES[axes[0]] if len(axes) == 1 else names


def picture(name: str, text: str) -> str:
    """An animation, or a still for readers who prefer reduced motion."""
    return (
        f'<picture class="scene"><source srcset="{name}{STILL}" '
        f'media="(prefers-reduced-motion: reduce)"><img src="{name}{MOVING}" alt="{text}" '
        f'width="{SIZE}" height="{SIZE}" loading="lazy"></picture>'
    )


def _horizon(task: Task) -> str:
    steps = f"{task.horizon} control steps, {task.horizon / CONTROL_RATE:g} seconds"
    published = f" (published code: {task.published_horizon})" if task.has_two_horizons else ""
    return f"{steps}{published}."


def _published(task: Task) -> Iterator[Row]:
    if task.name not in published_tasks():
        return
    for method in published_methods():
        found = {
            short: score
            for short in map(short_variant, task.variants)
            if (score := published_score(task.name, method, short))
        }
        if found:
            cells = {short: f"{s.mean:.2f}\u00a0±\u00a0{s.std:.2f}" for short, s in found.items()}
            yield Row(f"{method}, published", cells)


def _evaluated(task: Task, results: Sequence[Result], methods: Iterable[str]) -> Iterator[Row]:
    for method in methods:
        means: dict[str, list[float]] = {}
        for result in results:
            if result.entry.method == method and task.name in result.entry.tasks:
                for short, cell in by_variant(result.entry.scores)[task.name].items():
                    means.setdefault(short, []).append(float(np.mean([r.score for r in cell])))
        if means:
            label = "scripted expert" if method == EXPERT else f"{method}, best entry"
            yield Row(label, {short: _spread(values) for short, values in means.items()})


def _spread(values: Sequence[float]) -> str:
    deviation = f"\u00a0±\u00a0{np.std(values, ddof=1):.2f}" if len(values) > 1 else ""
    return f"{np.mean(values):.2f}{deviation}"
