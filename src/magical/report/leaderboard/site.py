"""The leaderboard's pages: an index, and a report of each method with its entries."""

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path

from magical import __version__
from magical.errors import ScoresError, SiteError, UnknownNameError
from magical.evaluation.protocol import NUDGE, ROLLOUTS
from magical.grouping import group_by
from magical.report.found.search import Found, Result, search_results
from magical.report.leaderboard.checks import Rejected, by_reasons, check_entries
from magical.report.leaderboard.ranking import STATE, Board, make_boards
from magical.report.pages.evaluated import write_page
from magical.report.pages.page import render_template, write_text
from magical.report.scores.differences import matching_methods
from magical.report.scores.summaries import interval_text
from magical.runs.plan import file_name
from magical.runs.sources import CLASSES, SOURCES

INDEX = "index.html"
METHODS, ENTRIES = "methods", "entries"  # folders of the site
NUMBER = "[0-9][0-9][0-9]"  # precedes a method's name in file names
MARK = b"<h1>MAGICAL leaderboard</h1>"  # in the index page


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """The ranked methods, and the entries that are not ranked."""

    boards: Sequence[Board]
    accepted: Sequence[Result]
    rejected: Sequence[Rejected]
    rerun: frozenset[str] = frozenset()  # methods whose rollouts were run again

    def write(self, site: Path) -> None:
        """Write the pages, and copies of the entries that they link to, so that links stay valid.

        Pages and copies of an earlier leaderboard in the folder are removed.

        Raises:
            SiteError: the index page, `methods` or `entries` exists but is not a leaderboard's.
            OSError: the folder cannot be written to.
        """
        index = site / INDEX
        taken = [path for path in (index, site / METHODS, site / ENTRIES) if path.exists()]
        if taken and not (index.exists() and MARK in index.read_bytes()):
            raise SiteError(f"{taken[0]}: expected none or a leaderboard's; choose another folder")
        groups = group_by(self.accepted, attrgetter("entry.method"))
        pages: dict[str, str] = {}
        copies: set[str] = set()
        for number, (method, results) in enumerate(groups.items(), 1):
            name = f"{number:03d}-{file_name(method)}"
            pages[method] = f"{METHODS}/{name}.html"
            copies |= _write_method(site, method, results, name)
        write_text(index, self._html(pages))
        _remove_others(site, {Path(page).name for page in pages.values()}, copies)

    def _html(self, pages: dict[str, str]) -> str:
        used = {name for board in self.boards for row in board.standings for name in row.used}
        filters = {**SOURCES, STATE: "the true state instead of an observation"}
        return render_template(
            "leaderboard.html.j2",
            board=self,
            interval_text=interval_text,
            unranked=by_reasons(self.rejected),
            classes={name: SOURCES[source] for name, source in CLASSES.items()},
            pages=pages,
            filters={name: text for name, text in filters.items() if name in used},
            rollouts=ROLLOUTS,
            nudge=f"{NUDGE:g}",
            version=__version__,
        )


def make_leaderboard(
    folders: Iterable[Path | str], site: Path | None = None, rerun: Iterable[str] = ()
) -> Leaderboard:
    """Check and rank all entries in or below the folders, except the copies in a site.

    Args:
        folders: folders with entries, at any depth.
        site: the folder that the pages will be written to.
        rerun: methods whose rollouts were run again, which are marked.

    Raises:
        ScoresError: a folder is missing.
        UnknownNameError: a method to mark is not ranked.
    """
    places = list(map(Path, folders))
    for place in places:
        if not place.is_dir():
            raise ScoresError(f"{place}: expected a folder with entries, found none")
    accepted, rejected = check_entries(search_results(places, without=site and site / ENTRIES))
    methods = {result.entry.method for result in accepted}
    if unknown := sorted(set(rerun) - methods):
        raise UnknownNameError(f"expected ranked methods to mark as rerun, found {unknown}")
    return Leaderboard(make_boards(accepted), accepted, rejected, frozenset(rerun))


def _write_method(site: Path, method: str, results: Sequence[Result], name: str) -> set[str]:
    """Write one method's report and copies of its entries; returns the copies' folder names."""
    copied = []
    for number, result in enumerate(results, 1):
        folder = site / ENTRIES / f"{name}-{number}"
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier leaderboard
        result.entry.write(folder)
        copied.append(replace(result, folder=folder))
    page = site / METHODS / f"{name}.html"
    published = matching_methods(result.entry for result in results)
    write_page(page, method, Found(copied), published)
    return {result.folder.name for result in copied}


def _remove_others(site: Path, pages: set[str], copies: set[str]) -> None:
    """Remove all other methods' pages and copies of entries, by name."""
    for page in (site / METHODS).glob(f"{NUMBER}-*.html"):
        if page.name not in pages:
            page.unlink()
    for folder in (site / ENTRIES).glob(f"{NUMBER}-*"):
        if folder.name not in copies:
            shutil.rmtree(folder)
