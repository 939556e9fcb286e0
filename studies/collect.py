"""Collect the scores of a plan's runs in `studies/STUDY/results/PLAN`, without weights.

python -m studies.collect RUNS [RUNS ...] --out studies/STUDY/results/PLAN [--plan FILE]
    [--leaderboard] [--test-evaluations N] [--dataset NAME] [--import MODULE ...]

RUNS are results folders of `magical run`, finished or not; several may hold parts of one plan. Runs
that were collected before are kept and not read again, so the command can be repeated while runs
are in progress. It writes

- `entries.json` and `scores.csv.gz`: every run's entry, by its folder, and its evaluation for the
  leaderboard if there is one, in the format of `magical report` and `magical leaderboard`
- `plan.json`: the plan's runs; version, demonstrations, and each run's seconds or error

Entries of runs that are no longer in the plan are kept but do not count.

With --leaderboard, each finished run is first evaluated by the leaderboard's protocol, from its
checkpoint, into `leaderboard` in its run folder, unless that was done before. --test-evaluations
states in newly collected entries how often test variants had been evaluated before, --dataset whose
demonstrations a dataset of the plan holds (`human`).

Runs made with a different version of the package than those collected before are left out.
"""

import argparse
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from magical.errors import MagicalError, RunFolderError
from magical.evaluation import Entry, read_entry
from magical.evaluation.entry import ENTRY_FILE, read_collection, write_collection
from magical.evaluation.protocol import NUDGE, Evaluation, environments
from magical.plugins import import_user_module
from magical.runs import PLAN, RUNS, read_json, write_json
from magical_baselines.experiments.one_run import evaluate_run
from magical_baselines.experiments.plan import DATASET, PlannedRun, planned_runs, read_plan
from magical_baselines.experiments.status import DONE, read_result
from studies.plan_results import LEADERBOARD

COLLECTED = "collected"  # key in `plan.json`: what is known about the runs
VARIED = ("tasks", "seed")  # settings in which runs of a method differ
# Options that are no more, with the value that makes a run what today's are.
LEFT: dict[str, Any] = {"init_from": "", "augment_by": "resampling", "transform": "none"}
LEFT |= {"augment_scale": 1.0, "average_decay": 0.0}
LEFT |= {"autoencoder": "appendix", "weight_metric": "euclidean", "weight_decay": 1e-4}
LEFT |= {"kl_weight": 10.0, "ensemble_decay": 0.01}
# Where a network of the studies was, and where it is now.
MOVED = {
    "studies.learners.candidate_networks.two_layers:NETWORK": (
        "studies.demonstrations.two_layers:NETWORK"
    )
}
DIGITS = 10  # hexadecimal digits of a digest of settings


@dataclass
class Collected:
    """What was collected from a plan's runs.

    Attributes:
        version: the package version that all runs were made with; empty before the first run.
        demonstrations, generated: digests of demonstrations, which were recorded once.
        runs: seconds of training and evaluation, time of completion, method, tasks, seed, and the
            key of the run's settings, by run folder.
        failed: the error of each run that failed.
        settings: the settings of runs, except tasks and seed, by digest.
        first_runs: empty; plans had fine-tuned runs once.
        entries: entries by `runs/FOLDER` and `runs/FOLDER/leaderboard`.
    """

    version: str = ""
    demonstrations: dict[str, str] = field(default_factory=dict)
    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    generated: dict[str, str] = field(default_factory=dict)
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    first_runs: dict[str, str] = field(default_factory=dict)
    entries: dict[str, Entry] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for settings in self.settings.values():
            config = settings["config"]
            if config.get("augment_by") == "auto" and settings["expert_demos"] is None:
                config["augment_by"] = "resampling"  # as recorded frames were
            if config.get("network") in MOVED:
                config["network"] = MOVED[config["network"]]
            settings["config"] = dict(each for each in config.items() if each not in LEFT.items())

    @classmethod
    def read(cls, folder: Path) -> "Collected":
        """Read what was collected before; empty for a new folder."""
        if not (folder / PLAN).exists():
            return cls()
        found = read_json(folder / PLAN)[COLLECTED]
        entries = read_collection(folder)
        if damaged := [entry for entry in entries.values() if not isinstance(entry, Entry)]:
            raise damaged[0]
        return cls(**found, entries={k: e for k, e in entries.items() if isinstance(e, Entry)})

    def add(self, name: str, record: Mapping[str, Any], entry: Entry) -> None:
        """Add a finished run, from its final record and its entry."""
        self.entries[f"{RUNS}/{name}"] = entry
        self.failed.pop(name, None)
        config = dict(record["settings"]["config"])
        varied = {part: config.pop(part) for part in VARIED}
        settings = {**record["settings"], "config": config}
        key = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:DIGITS]
        self.settings[key] = settings
        seconds = {part: round(float(s), 1) for part, s in record["seconds"].items()}
        ended = {"seconds": seconds, "finished": record["finished"]}
        self.runs[name] = {**ended, "method": entry.method, **varied, "settings": key}

    def record(self, name: str) -> dict[str, Any]:
        """The final record of a run, as far as it was collected."""
        facts = dict(self.runs[name])
        settings = self.settings[facts["settings"]]
        config = {**settings["config"], **{part: facts.pop(part) for part in VARIED}}
        return {**facts, "settings": {**settings, "config": config}}

    def adopt(self, planned: Mapping[str, PlannedRun]) -> None:
        """Rename runs with an earlier name, which had a digest of the settings, to the plan's."""
        earlier = {name: self.record(name) for name in self.runs.keys() - planned.keys()}
        for run in planned.values():
            if run.folder in self.runs:
                continue
            name = next((name for name in earlier if _is_same_run(run, earlier[name])), None)
            if name:
                self.runs[run.folder] = self.runs.pop(name)
                for key in [key for key in self.entries if Path(key).parts[1] == name]:
                    renamed = Path(RUNS, run.folder, *Path(key).parts[2:]).as_posix()
                    self.entries[renamed] = self.entries.pop(key)

    def write(self, folder: Path, runs: Sequence[Mapping[str, Any]]) -> None:
        """Write everything, with the list of the plan's runs."""
        known = {name: value for name, value in vars(self).items() if name != "entries"}
        write_json(folder / PLAN, {"runs": runs, COLLECTED: known})
        write_collection(folder, self.entries)


def collect(
    sources: Sequence[Path],
    out: Path,
    plan: Path,
    leaderboard: bool = False,
    **stated: Any,
) -> Iterator[str]:
    """Collect the plan's finished runs; yields what is left out or missing, and why.

    Args:
        sources: results folders.
        out: the folder to collect into.
        plan: the plan's file.
        leaderboard: whether to evaluate each run by the leaderboard's protocol first.
        stated: `test_evaluations` and `dataset`, passed to `_entry`.

    Raises:
        RunFolderError: a source is not a results folder.
    """
    planned = {run.folder: run for run in planned_runs(read_plan(plan))}
    collected = Collected.read(out)
    collected.adopt(planned)
    for source in sources:
        if not (source / PLAN).is_file():
            raise RunFolderError(f"{source}: expected a results folder, found no {PLAN}")
        for folder in sorted(path for path in (source / RUNS).glob("[!.]*") if path.is_dir()):
            if folder.name not in planned:
                yield f"left out: {folder}: not a run of {plan}"
                continue
            run = planned[folder.name] if leaderboard else None
            if why := _collect_run(run, folder, collected, stated):
                yield f"left out: {why}"
    for runs in (collected.runs, collected.failed):
        for name in sorted(set(runs) - set(planned)):
            del runs[name]
            yield f"does not count any more: {out / RUNS / name}: not a run of {plan}"
    collected.write(out, [asdict(run.listed()) for run in planned.values()])
    entries = (collected.entries[f"{RUNS}/{name}"] for name in collected.runs)
    commits = Counter(entry.record.commit or "unknown" for entry in entries)
    if len(commits) > 1:
        shown = ", ".join(f"{count} of {commit:.7}" for commit, count in commits.items())
        yield f"note: runs of several commits: {shown}"
    for run in planned.values():
        if run.folder not in collected.runs:
            yield f"missing: {run}: {collected.failed.get(run.folder, 'not done')}"


def _collect_run(
    run: PlannedRun | None, folder: Path, collected: Collected, stated: Mapping[str, Any]
) -> str:
    """Collect a finished run and its leaderboard evaluation, if new; returns an error or "".

    If `run` is given, it is evaluated for the leaderboard first.
    """
    name = folder.name
    key = f"{RUNS}/{name}"
    second = f"{key}/{LEADERBOARD}"
    try:
        record = read_result(folder)
        if run and second not in collected.entries and record.get("state") == DONE:
            evaluate_for_leaderboard(run, folder)
        if name not in collected.runs and record:
            if record["state"] == DONE:
                entry = _entry(folder, collected.version, **stated)
                collected.version = entry.version
                collected.add(name, record, entry)
            else:
                collected.failed[name] = str(record["error"])
        new = second not in collected.entries and name in collected.runs
        if new and (folder / LEADERBOARD / ENTRY_FILE).exists():
            collected.entries[second] = _entry(folder / LEADERBOARD, collected.version, **stated)
    except MagicalError as error:
        return str(error)
    return ""


def evaluate_for_leaderboard(run: PlannedRun, folder: Path) -> None:
    """Evaluate a run by the leaderboard's protocol, unless that was done before."""
    if not (folder / LEADERBOARD / ENTRY_FILE).exists():
        env_ids = tuple(environments(run.tasks))
        evaluation = Evaluation(env_ids=env_ids, nudge=NUDGE)
        evaluate_run(run, folder, folder / LEADERBOARD, evaluation)


def _is_same_run(run: PlannedRun, record: Mapping[str, Any]) -> bool:
    """Whether a final record is of a run with these settings.

    Newer options take their defaults; options that are no more do not count.
    """
    settings, options = record["settings"], run.config.to_dict()
    of = settings["config"]["tasks"], settings["config"]["seed"]
    if (record["method"], *of) != (run.method, list(run.tasks), run.seed):
        return False
    config = {name: value for name, value in settings["config"].items() if name in options}
    try:
        config = type(run.config).from_dict(config).to_dict()
    except MagicalError:  # of another algorithm
        return False
    then, now = {**settings, "config": config}, run.settings()
    return json.dumps(then, sort_keys=True) == json.dumps(now, sort_keys=True)


def _entry(
    folder: Path, version: str, test_evaluations: int | None = None, dataset: str = DATASET
) -> Entry:
    """A run's entry, with `test_evaluations` if stated and the dataset's name."""
    entry = read_entry(folder)
    if version not in ("", entry.version):
        raise RunFolderError(
            f"{folder}: expected an entry made by {version}, found {entry.version}"
        )
    record = entry.record
    demonstrations = record.demonstrations.replace(DATASET, dataset)
    number = record.test_evaluations if test_evaluations is None else test_evaluations
    record = replace(record, demonstrations=demonstrations, test_evaluations=number)
    return replace(entry, record=record)


def main(arguments: Sequence[str]) -> int:
    """Collect, and print what is left out or missing."""
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("sources", nargs="+", type=Path, metavar="RUNS")
    parser.add_argument("--out", type=Path, required=True, metavar="studies/STUDY/results/PLAN")
    parser.add_argument(
        "--plan", type=Path, metavar="FILE", help="default: studies/STUDY/plans/PLAN.toml"
    )
    parser.add_argument("--leaderboard", action="store_true", help="evaluate for it first")
    parser.add_argument(
        "--test-evaluations", type=int, metavar="N", help="how often test variants were evaluated"
    )
    parser.add_argument("--dataset", default=DATASET, metavar="NAME", help="such as human")
    parser.add_argument(
        "--import", dest="imports", nargs="+", default=[], help="modules that the plan names"
    )
    args = parser.parse_args(arguments)
    for module in args.imports:
        import_user_module(module)
    number = args.test_evaluations
    if number is not None and number < 0:
        parser.error(f"--test-evaluations: expected 0 or more, found {number}")
    name = f"{args.out.absolute().name}.toml"
    plan = args.plan or args.out.absolute().parents[1] / "plans" / name
    stated = {"test_evaluations": number, "dataset": args.dataset}
    try:
        for line in collect(args.sources, args.out, plan, args.leaderboard, **stated):
            print(line)
        print(f"{args.out}: {len(Collected.read(args.out).runs)} runs collected")
    except MagicalError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
