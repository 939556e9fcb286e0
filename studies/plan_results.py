"""A study's plan, and what was collected from its runs."""

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from statistics import fmean
from typing import Any

from magical.grouping import group_by
from magical.runs import read_json

NOT_RUN = "not run"
NOTHING = f"Nothing yet: {NOT_RUN}."
# Plans on the page about the published tables.
PLANS = (
    "bc-human",
    "bc-human-paper",
    "bc-multi-human",
    "bc-ablations-human",
    "adversarial-human",
    "gail-published-code",
    "gail-discriminator",
    "adversarial-published-code",
    "bc-scripted",
    "bc-perturbed",
    "bc-mixed",
    "bc-perturbed-100",
    "training-time",
    "training-time-multi",
    "training-time-adversarial",
    "settings",
    "settings-published-code",
    "settings-adversarial",
    "settings-gail",
    "object-bc",
    "object-bc-human",
)
# Plans whose rows are on separate pages; they are also on the leaderboard.
OTHERS = (
    *("object-bc-ablations", "object-bc-ablations-human", "bc-transformations"),
    *("sequence-learners", "sequence-learners-longer", "sequence-learners-executed"),
    *("sequence-learners-hundred", "iq-learn", "held-out", "sequence-learners-held-out"),
    *("program-bc-human", "program-bc-perception", "program-bc-training", "program-bc-held-out"),
    *("program-bc-scripted", "program-bc-few", "object-networks-human"),
)
LEADERBOARD = "leaderboard"  # in a run folder: the evaluation by the leaderboard's protocol


@dataclass(frozen=True)
class PlanResults:
    """A study's plan, and what was collected from its runs."""

    name: str
    study: str
    plan: Mapping[str, Any]  # the TOML file
    collected: Mapping[str, Any]  # empty if nothing was collected

    @classmethod
    def read(cls, root: Path, name: str) -> "PlanResults":
        (path,) = root.glob(f"studies/*/plans/{name}.toml")
        collected = path.parents[1] / "results" / name / "plan.json"
        found = read_json(collected)["collected"] if collected.is_file() else {}
        return cls(name, path.parts[-3], tomllib.loads(path.read_text("utf-8")), found)

    @property
    def methods(self) -> list[str]:
        return [method["name"] for method in self.plan["methods"]]

    @property
    def planned(self) -> int:
        """The number of planned runs."""
        tasks, seeds = len(self.plan["tasks"]), len(self.plan["seeds"])
        groups = [1 if method.get("multi_task") else tasks for method in self.plan["methods"]]
        return sum(groups) * seeds

    def training_minutes(self, tasks: Collection[str]) -> dict[str, float]:
        """Mean training time of runs on any of these tasks, in minutes, by method."""
        runs = self.collected.get("runs", {}).values()
        runs = group_by(
            (run for run in runs if not set(tasks).isdisjoint(run["tasks"])), itemgetter("method")
        )
        seconds = {name: [run["seconds"]["training"] for run in of] for name, of in runs.items()}
        return {name: fmean(each) / 60 for name, each in seconds.items()}

    def row(self) -> list[str]:
        """The plan, its runs, hours, minutes per run, package version, and what is missing."""
        runs = self.collected.get("runs", {})
        seconds = sum(sum(run["seconds"].values()) for run in runs.values())
        failed = len(self.collected.get("failed", {}))
        left = self.planned - len(runs) - failed
        state = [f"{failed} failed"] * bool(failed) + [f"{left} {NOT_RUN}"] * bool(left)
        return [
            f"[{self.name}](../{self.study}/plans/{self.name}.toml)",
            f"{len(runs)} of {self.planned}",
            f"{seconds / 3600:.1f}" if runs else "–",
            f"{seconds / 60 / len(runs):.1f}" if runs else "–",
            self.collected.get("version", "–"),
            ", ".join(state) or "–",
        ]
