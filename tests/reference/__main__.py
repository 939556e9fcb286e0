"""Compare the package with recordings of the published environments.

Without arguments, every recording in `data` is checked; with a kind, those of that kind; with a
kind and a file, a recording of your own. Prints each figure with its limit; the exit status is 1
if a limit is exceeded. A file without recorded results is computed but not compared; OUT receives
what was computed.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

from magical.commands._common import print_table
from tests.reference.recordings import DATA, RECORDINGS, Comparison, RecordingError


def main(argv: Sequence[str] | None = None) -> int:
    """Check each recording, print the figures; 0 if all passed, 1 if not."""
    parser = argparse.ArgumentParser(prog="python -m tests.reference", description=__doc__)
    parser.add_argument("kind", nargs="?", choices=RECORDINGS, help="default: all kinds")
    parser.add_argument("recording", nargs="?", type=Path, help="default: those in data")
    parser.add_argument("out", nargs="?", type=Path, help="file for what was computed")
    args = parser.parse_args(argv)
    kinds = [args.kind] if args.kind else RECORDINGS
    recordings = [(kind, DATA / name) for kind in kinds for name in RECORDINGS[kind]]
    if args.recording:
        recordings = [(args.kind, args.recording)]
    try:
        passed = [_check(kind, path, args.out) for kind, path in recordings]
    except RecordingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0 if all(passed) else 1


def _check(kind: str, path: Path, out: Path | None) -> bool:
    """Load, compute, write, compare and print one recording; whether it is within its limits."""
    module = importlib.import_module(f"tests.reference.{kind}")
    data = module.load(path)
    computed = module.compute(data)
    if out:
        module.write(computed, out)
        print(f"wrote {out}", file=sys.stderr)
    comparisons: list[Comparison] = module.compare(data, computed)
    if not comparisons:
        print(f"{path} holds no recorded results: nothing compared", file=sys.stderr)
        return True
    print(f"{path.name} ({kind})")
    rows = [
        (status, one.name, f"{one.figure:.4g}", f"{one.limit:g}", one.unit, one.detail)
        for one in comparisons
        for status in ["ok" if one.passed else "MISSED"]
    ]
    print_table(("", "what", "figure", "limit", "unit", "detail"), rows)
    return all(one.passed for one in comparisons)


if __name__ == "__main__":
    sys.exit(main())
