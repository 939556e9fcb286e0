"""Learning curves of runs.

python -m studies.modern_baselines.curves RUN... --out FILE.png

RUN is a run folder with metrics. Of learners that act in environments the scores of training
episodes, a panel for each task and a line for each run; of others the loss, a panel for each
learner and a line for each task.
"""

import argparse
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from magical.runs import read_metrics
from magical.runs.folder import CONFIG, read_json

COLOUR = "#c8467c"
SMOOTHED = 10  # rows of metrics, of 512 environment steps each
PANEL = 2.8  # inches
Rows = list[dict[str, Any]]


def main() -> None:
    """Read the metrics and plot them."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    runs = [(read_json(run / CONFIG), read_metrics(run)) for run in args.runs]
    scored = all("score" in rows[-1] for _, rows in runs)
    panels = defaultdict(list)
    for config, rows in runs:
        (task,) = config["tasks"]
        panels[task if scored else learner(config)].append((task, rows))
    figure = Figure(figsize=(PANEL * max(3, len(panels)), PANEL), layout="constrained")
    all_axes = np.ravel(figure.subplots(1, len(panels), sharey=scored))
    for axes, (title, lines) in zip(all_axes, panels.items(), strict=True):
        axes.set_title(title, fontsize="medium")
        axes.spines[["top", "right"]].set_visible(False)
        (plot_scores if scored else plot_losses)(axes, lines)
    all_axes[0].set_ylabel("score of episodes in training" if scored else "training loss")
    if not scored:
        figure.legend(
            *all_axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False
        )
    figure.savefig(args.out, dpi=110)


def learner(config: dict[str, Any]) -> str:
    """The algorithm, and whether it has past actions."""
    without = config.get("past_actions") is False
    return f"{config['algorithm']}{', no past actions' if without else ''}"


def plot_scores(axes: Axes, lines: list[tuple[str, Rows]]) -> None:
    """Scores over environment steps."""
    for _, rows in lines:
        steps, scores = np.array([(row["environment_steps"], row["score"]) for row in rows]).T
        mean = np.convolve(scores, np.ones(SMOOTHED) / SMOOTHED, "valid")
        axes.plot(steps[SMOOTHED - 1 :] / 1000, mean, color=COLOUR, linewidth=1.2)
    axes.set(xlabel="environment steps, thousands", ylim=(0, 1.02))


def plot_losses(axes: Axes, lines: list[tuple[str, Rows]]) -> None:
    """Losses over batches."""
    for number, (task, rows) in enumerate(lines):
        steps, losses = np.array([(row["step"], row["loss"]) for row in rows]).T
        axes.plot(steps, losses, color=colormaps["tab10"](number), linewidth=1.0, label=task)
    axes.set(xlabel="batches", yscale="log")


if __name__ == "__main__":
    main()
