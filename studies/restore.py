"""Make a results folder from what was collected, so that `magical run` does only the other runs.

python -m studies.restore studies/STUDY/results/PLAN --out RUNS [--again SEED]

RUNS is a folder that does not exist yet. In it, the collected runs count as done. They have scores
but no weights, so they can be reported but not evaluated again. Then

magical run studies/STUDY/plans/PLAN.toml --out RUNS

does the missing runs, with the same version of the package and the same demonstrations, and
`studies/collect.py` collects them. With --again, the runs of a seed are left out and so done again,
for their weights (`studies/weights.py`).
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from magical.errors import MagicalError, RunFolderError
from magical.runs import PLAN, RESULT, RUNS, read_json, write_json
from magical_baselines.experiments.plan import folder_name
from magical_baselines.experiments.status import DONE
from studies.collect import Collected


def restore(source: Path, out: Path, again: int | None = None) -> int:
    """Make the results folder; returns the number of finished runs in it.

    Args:
        source: the folder with what was collected from a plan's runs.
        out: the results folder to make.
        again: the training seed whose runs are left out.

    Raises:
        RunFolderError: nothing was collected in `source`, or `out` exists.
    """
    collected = Collected.read(source)
    if not collected.runs:
        raise RunFolderError(f"{source}: expected collected runs, found none")
    if out.exists():
        raise RunFolderError(f"{out}: expected a new folder; give another --out")
    for name in [name for name, facts in collected.runs.items() if facts["seed"] == again]:
        del collected.runs[name]
    runs = read_json(source / PLAN)["runs"]
    # Names of folders had digests once.
    names = {run["folder"]: folder_name(run["method"], run["tasks"], run["seed"]) for run in runs}
    for name in collected.runs:
        write_json(out / RUNS / names[name] / RESULT, {"state": DONE, **collected.record(name)})
    for key, entry in collected.entries.items():
        _, name, *rest = Path(key).parts
        if name in collected.runs:
            entry.write(Path(out, RUNS, names[name], *rest))
    write_json(out / PLAN, {"runs": [{**run, "folder": names[run["folder"]]} for run in runs]})
    return len(collected.runs)


def main(arguments: Sequence[str]) -> int:
    """Restore, and print how many runs are done."""
    assert __doc__
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path, metavar="studies/STUDY/results/PLAN")
    parser.add_argument("--out", type=Path, required=True, metavar="RUNS")
    parser.add_argument("--again", type=int, metavar="SEED", help="leave out the runs of this seed")
    args = parser.parse_args(arguments)
    try:
        print(f"{args.out}: {restore(args.source, args.out, args.again)} runs done")
    except MagicalError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
