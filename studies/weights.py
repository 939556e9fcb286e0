"""Pack the weights of a plan's runs of one seed, so that others can verify the collected scores.

python -m studies.weights pack RUNS --results studies/STUDY/results/PLAN --out FILE.zip [--seed 0]
python -m studies.weights unpack FILE.zip --results studies/STUDY/results/PLAN --out DIR

`pack` takes runs from a results folder of `magical run`. Their scores must equal the collected
ones, rollout by rollout; otherwise the weights are not those that were scored, and it fails. Of
each run it keeps the policy's weights, the configuration, `run.json` and the collected entry. The
archive's name and SHA-256 digest are written to `weights.json`, next to the collected scores.

`unpack` makes run folders from an archive with that digest. `magical verify DIR/RUN` runs a sample
of a run's rollouts again.
"""

import argparse
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from magical.errors import MagicalError, ResultsError
from magical.evaluation import Entry, read_entry
from magical.experiments.results import DONE, read_state
from magical.files import sha256_sum, write_atomically
from magical.learning.running.checkpoints import load_checkpoint, save_checkpoint
from magical.runs.folder import CHECKPOINT, CONFIG, RECORD, read_json, write_json
from magical.runs.plan import RUNS
from studies.collect import Collected

WEIGHTS = "weights.json"  # in the folder of collected results
DATE = (1980, 1, 1, 0, 0, 0)  # of all files in an archive: the same weights give the same bytes


def pack(source: Path, results: Path, out: Path, seed: int = 0) -> list[str]:
    """Pack the runs of a seed into one archive, and record its digest; returns the runs' names.

    Args:
        source: a results folder of `magical run`.
        results: the folder with what was collected from the plan's runs.
        out: the archive to write.
        seed: the training seed.

    Raises:
        ResultsError: no run of the seed was collected, a run is missing in `source`, or its scores
            are not the collected ones.
        CheckpointError: a run has no intact checkpoint.
    """
    collected = Collected.read(results)
    names = [name for name, facts in sorted(collected.runs.items()) if facts["seed"] == seed]
    entries = {name: collected.entries[f"{RUNS}/{name}"] for name in names}
    if not entries:
        raise ResultsError(f"{results}: expected collected runs of seed {seed}, found none")
    for name, entry in entries.items():
        _require_scores(source / RUNS / name, entry)
    with write_atomically(out) as file, zipfile.ZipFile(file, "w") as archive:
        for name, entry in entries.items():
            for path, data in _files(source / RUNS / name, entry):
                archive.writestr(zipfile.ZipInfo(f"{name}/{path}", DATE), data)
    write_json(
        results / WEIGHTS,
        {
            "file": out.name,
            "bytes": out.stat().st_size,
            "sha256": sha256_sum(out),
            "seed": seed,
            "runs": list(entries),
        },
    )
    return list(entries)


def unpack(archive: Path, results: Path, out: Path) -> list[str]:
    """Make run folders from an archive that has the recorded digest; returns their names.

    Raises:
        ResultsError: no weights of the plan were packed, the archive has another digest, or `out`
            exists.
    """
    if not (results / WEIGHTS).exists():
        raise ResultsError(f"{results}: expected {WEIGHTS}, found none: no weights were packed")
    stated = read_json(results / WEIGHTS)
    if (found := sha256_sum(archive)) != stated["sha256"]:
        raise ResultsError(
            f"{archive}: expected {stated['file']} with SHA-256 {stated['sha256']}, found {found}"
        )
    if out.exists():
        raise ResultsError(f"{out}: expected a new folder; give another --out")
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(out)
    return list(stated["runs"])


def _require_scores(folder: Path, entry: Entry) -> None:
    if read_state(folder) != DONE:
        raise ResultsError(f"{folder}: expected a run that is done, found none")
    if list(read_entry(folder).scores) != list(entry.scores):
        raise ResultsError(
            f"{folder}: expected the collected scores, found others: these are not the weights "
            "that were scored"
        )


def _files(folder: Path, entry: Entry) -> Iterator[tuple[str, bytes]]:
    """The files of a run to archive; the checkpoint without what only training needs."""
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary)
        state = load_checkpoint(folder / CHECKPOINT)
        save_checkpoint(out / CHECKPOINT, {name: state[name] for name in ("step", "policy")})
        config = read_json(folder / CONFIG)
        if "demos" in config:  # a path on the training machine
            config["demos"] = Path(config["demos"]).name
        write_json(out / CONFIG, config)
        write_json(out / RECORD, read_json(folder / RECORD))
        entry.write(out)
        for path in sorted(out.iterdir()):
            yield path.name, path.read_bytes()


def main(arguments: Sequence[str]) -> int:
    """Pack or unpack, and print the number of runs."""
    assert __doc__
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("action", choices=("pack", "unpack"))
    parser.add_argument("source", type=Path, metavar="RUNS or FILE.zip")
    parser.add_argument("--results", type=Path, required=True, metavar="studies/STUDY/results/PLAN")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.zip or DIR")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: 0")
    args = parser.parse_args(arguments)
    try:
        if args.action == "pack":
            names = pack(args.source, args.results, args.out, args.seed)
        else:
            names = unpack(args.source, args.results, args.out)
    except MagicalError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{args.out}: {len(names)} runs")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
