"""Learning curves of the runs of an interactive learner, a panel for each task and a line a seed.

python -m studies.modern_baselines.curves RUN... --out FILE.png

RUN is a run folder with metrics.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from magical.runs import read_metrics
from magical.runs.folder import CONFIG, read_json

COLOUR = "#c8467c"
SMOOTHED = 10  # rows of metrics, of 512 environment steps each


def main() -> None:
    """Read the metrics and plot them."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    by_task = defaultdict(list)
    for run in args.runs:
        (task,) = read_json(run / CONFIG)["tasks"]
        by_task[task].append(read_metrics(run))
    figure = Figure(figsize=(9.6, 2.8), layout="constrained")
    panels = np.ravel(figure.subplots(1, len(by_task), sharey=True))
    for axes, (task, runs) in zip(panels, by_task.items(), strict=True):
        for rows in runs:
            steps, scores = np.array([(row["environment_steps"], row["score"]) for row in rows]).T
            mean = np.convolve(scores, np.ones(SMOOTHED) / SMOOTHED, "valid")
            thousands = steps[SMOOTHED - 1 :] / 1000
            axes.plot(thousands, mean, color=COLOUR, linewidth=1.2)
        axes.set(title=task, xlabel="environment steps, thousands", ylim=(0, 1.02))
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_ylabel("score of episodes in training")
    figure.savefig(args.out, dpi=110)


if __name__ == "__main__":
    main()
