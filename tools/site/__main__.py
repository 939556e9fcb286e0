"""Build the documentation site into `site/` (`make docs`).

python -m tools.site [--out FOLDER]

Fails on broken links, anchors and references, and prints the file and line of each.
"""

import argparse
import logging
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml
from mkdocs.commands.build import build
from mkdocs.config import load_config

from magical.report.leaderboard import make_leaderboard
from tools.site import environments, leaderboard, reference, suite
from tools.site.staging import Source, assets, place, repository_pages

ROOT = Path(__file__).resolve().parents[2]
ENTRIES = ("studies", "entries")  # folders with evaluated runs
NOTEBOOK = "examples/tutorial.ipynb"
WORK = ROOT / "build"  # intermediate files, and cached pictures
ELSEWHERE = re.compile(
    r'<(?:script|img|source|iframe)\b[^>]*\bsrc(?:set)?="https?:[^"]*"'
    r'|<link\b[^>]*\bhref="https?:[^"]*"'
)
FOUND = (
    re.compile(r"Doc file '(?P<page>[^']+)' contains a link '(?P<link>[^']+)'"),
    re.compile(r"(?P<page>\S+\.md): .*cross-reference target '(?P<link>[^']+)'"),
)


class Warnings(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


def navigation(outline: Sequence[Any], pages: Sequence[str], named: set[str]) -> Iterator[Any]:
    """The outline of `mkdocs.yml`, with `folder/*` expanded to that folder's unlisted pages."""
    for item in outline:
        if isinstance(item, dict):
            ((title, inner),) = item.items()
            yield {
                title: list(navigation(inner, pages, named)) if isinstance(inner, list) else inner
            }
        elif item == f"{environments.FOLDER}/*":
            yield from environments.navigation()
        elif item.endswith("/*"):
            folder = item.removesuffix("*")
            yield from sorted(p for p in pages if p.startswith(folder) and p not in named)
        else:
            yield item


def _named(outline: Sequence[Any]) -> Iterator[str]:
    for item in outline:
        for inner in item.values() if isinstance(item, dict) else [item]:
            yield from _named(inner) if isinstance(inner, list) else [inner]


def build_site(out: Path) -> list[str]:
    """Build the site; returns the problems, each with file and line."""
    ranked = make_leaderboard([ROOT / name for name in ENTRIES])
    generated = {
        **assets(ROOT),
        **reference.pages(ROOT),
        **environments.pages(ROOT, WORK / "previews", ranked),
        **leaderboard.pages(ranked),
        **suite.pages(ROOT),
    }
    source = Source(ROOT, WORK / "docs", generated, {place(NOTEBOOK): NOTEBOOK})
    source.write(repository_pages(ROOT))
    pages = [path.relative_to(source.folder).as_posix() for path in source.folder.rglob("*.md")]
    outline = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    warnings = Warnings()
    logger = logging.getLogger("mkdocs")
    logger.addHandler(warnings)
    config = load_config(
        str(ROOT / "mkdocs.yml"),
        docs_dir=str(source.folder),
        site_dir=str(out),
        nav=list(navigation(outline, pages, set(_named(outline)))),
    )
    config.plugins.on_startup(command="build", dirty=False)
    build(config)
    config.plugins.on_shutdown()
    logger.removeHandler(warnings)
    found = (located(source, text) for text in warnings.messages)
    return [*source.problems, *found, *loaded_from_elsewhere(out)]


def loaded_from_elsewhere(site: Path) -> Iterator[str]:
    """Problems of pages that load something from another host, which is not allowed."""
    for page in sorted(site.rglob("*.html")):
        for found in ELSEWHERE.findall(page.read_text(encoding="utf-8")):
            yield f"{page.relative_to(site)}: loads from another host: {found}"


def located(source: Source, message: str) -> str:
    """A MkDocs warning with the file and line that it is about."""
    for pattern in FOUND:
        if found := pattern.search(message):
            return f"{source.locate(found['page'], found['link'])}: {message}"
    return message


def main(argv: Sequence[str] | None = None) -> int:
    """Build the site; returns 1 if anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tools.site", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "site", metavar="FOLDER")
    problems = build_site(parser.parse_args(argv).out.resolve())
    print(*problems, sep="\n", end="\n" if problems else "", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
