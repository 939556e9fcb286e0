"""Compare the package with recordings of the published environments.

Without arguments, every recording in the package is checked; with a kind, those of that kind; with
a kind and a file, a recording of your own. Prints each figure with its limit; the exit status is 1
if a limit is exceeded. A file without recorded results is computed but not compared; --out writes
what was computed.
"""

import argparse
import importlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

from magical.commands._common import UsageError, add_json, add_out, log, print_json, print_table
from magical.conformance.recordings import DATA, RECORDINGS, Comparison

HELP = "compare with recordings of the published environments"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "kind", nargs="?", choices=RECORDINGS, help="kind of recordings (default: all kinds)"
    )
    parser.add_argument(
        "recording",
        nargs="?",
        type=Path,
        metavar="RECORDING",
        help="a recording of that kind (default: those in the package)",
    )
    add_out(parser, "write what was computed for a single recording", "FILE")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Check each recording, print the figures, report whether all passed."""
    kinds = [args.kind] if args.kind else RECORDINGS
    recordings = [(kind, DATA / name) for kind in kinds for name in RECORDINGS[kind]]
    if args.recording:
        recordings = [(args.kind, args.recording)]
    if args.out and len(recordings) > 1:
        names = ", ".join(path.name for _, path in recordings)
        raise UsageError(f"--out: expected a single recording, found {names}")
    results: list[dict[str, Any]] = []
    for kind, path in recordings:
        if results:
            print()
        if len(recordings) > 1:
            print(f"{path.name} ({kind})")
        results.append(_check(kind, path, args.out))
    passed = all(result["passed"] for result in results)
    single = results[0] if len(results) == 1 else {}
    print_json(args, {**single, "passed": passed, "recordings": results})
    return 0 if passed else 1


def _check(kind: str, path: Path, out: Path | None) -> dict[str, Any]:
    """Load, compute, write, compare and print one recording; the result is for JSON."""
    module = importlib.import_module(f"magical.conformance.{kind}")
    data = module.load(path)
    computed = module.compute(data)
    if out:
        module.write(computed, out)
        log(f"wrote {out}")
    comparisons: list[Comparison] = module.compare(data, computed)
    if comparisons:
        rows = [
            (status, one.name, f"{one.figure:.4g}", f"{one.limit:g}", one.unit, one.detail)
            for one in comparisons
            for status in ["ok" if one.passed else "MISSED"]
        ]
        print_table(("", "what", "figure", "limit", "unit", "detail"), rows)
    else:
        log(f"{path} holds no recorded results: nothing compared")
    return {
        "kind": kind,
        "file": path.name,
        "passed": all(one.passed for one in comparisons),
        "lines": [asdict(one) for one in comparisons],
    }
