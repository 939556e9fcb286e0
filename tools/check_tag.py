"""Check that a tag, the package's version and the newest changelog entry agree.

    python tools/check_tag.py v1.0.0

The changelog entry must have a date, and there may be no unreleased changes.
"""

import re
import sys
from pathlib import Path

import magical

ROOT = Path(__file__).resolve().parents[1]
UNRELEASED = re.compile(r"^## \[Unreleased\]\s+(?!## )\S", re.MULTILINE)
ENTRY = re.compile(r"^## \[(?P<version>[^\]]+)\] - (?P<date>.+)$", re.MULTILINE)
DATE = re.compile(r"\d{4}-\d{2}-\d{2}")


def disagreements(tag: str, version: str, changelog: str) -> list[str]:
    """What is wrong, in words; empty if the release may be made."""
    found = []
    if tag != f"v{version}":
        found.append(
            f"expected the tag v{version}, by the package's version; found {tag or 'none'}"
        )
    entry = ENTRY.search(changelog)
    if entry is None or entry["version"] != version:
        newest = entry["version"] if entry else "none"
        found.append(f"expected {version} at the top of the changelog, found {newest}")
    elif not DATE.fullmatch(entry["date"]):
        found.append(f"expected the date of {version} in the changelog, found {entry['date']!r}")
    return found


def main(tag: str = "") -> int:
    """Print what is wrong; returns 1 if anything is."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    found = disagreements(tag, magical.__version__, changelog)
    if UNRELEASED.search(changelog):
        found.append("expected no unreleased changes in the changelog, found some")
    print(*found, sep="\n", end="\n" if found else "", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
