"""The site's source: pages of the repository and generated ones in one folder, links rewritten.

A page keeps its path in the repository, except in `docs/`, whose files move to the root. Lines of a
page stay lines, so that what MkDocs reports can be located by file and line.
"""

import posixpath
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

LINK = re.compile(r"(?<=\]\()([^)#\s]+)(?=[)#\s])")
CODE = re.compile(r"^ *```")
ELSEWHERE = ("https://", "http://", "mailto:")
SINGLE = (  # pages outside the folders of pages
    *("CHANGELOG.md", "CONTRIBUTING.md", "entries/README.md", "examples/plugin/README.md"),
    "tests/reference/data/README.md",
)
PYTHON, NOTEBOOK, PAGE = ".py", ".ipynb", ".md"


def place(path: str) -> str:
    """The path of a repository file in the site's source.

    Python files and notebooks in `examples` become pages; `README.md` becomes the index.
    """
    if path == "README.md":
        return "index.md"
    stem, suffix = posixpath.splitext(path)
    if path.startswith("examples/") and suffix in (PYTHON, NOTEBOOK):
        return f"{stem}{PAGE}"
    return path.removeprefix("docs/")


@dataclass
class Source:
    """The folder that MkDocs reads, and what has been put there.

    Args:
        root: the repository's root.
        folder: the source folder, which `write` replaces.
    """

    root: Path
    folder: Path
    generated: Mapping[str, str | bytes]  # by path in the site's source
    converted: Mapping[str, str]  # pages generated from a file with links -> that file's path
    origins: dict[str, str] = field(default_factory=dict)  # site path -> repository path
    problems: list[str] = field(default_factory=list)  # each with file and line

    def write(self, pages: list[str]) -> None:
        """Write these pages of the repository, files they link to, and generated pages."""
        shutil.rmtree(self.folder, ignore_errors=True)
        for name, content in self.generated.items():
            self._put(name, content if isinstance(content, bytes) else content.encode())
        for name, path in self.converted.items():
            text = (self.folder / name).read_text(encoding="utf-8")
            self._put(name, "".join(self._rewritten(path, text)).encode())
        for path in pages:
            self.origins[place(path)] = path
            text = (self.root / path).read_text(encoding="utf-8")
            self._put(place(path), "".join(self._rewritten(path, text)).encode())

    def _rewritten(self, path: str, text: str) -> Iterator[str]:
        """The lines of a page, with links rewritten for the site."""
        in_code = False
        for number, line in enumerate(text.splitlines(keepends=True), 1):
            if CODE.match(line):
                in_code = not in_code
            if in_code:
                yield line
                continue
            yield LINK.sub(partial(self._link, path, f"{path}:{number}"), line)

    def _link(self, path: str, at: str, found: re.Match[str]) -> str:
        """A link's target in the site; a linked file that is not a page is copied there."""
        target = found[1]
        if target.startswith(ELSEWHERE):
            return target
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
        there = place(wanted)
        if there not in self.generated:
            if not (self.root / wanted).is_file():
                self.problems.append(f"{at}: link to {target}: no such file")
            elif not wanted.endswith(PAGE):
                self._put(there, (self.root / wanted).read_bytes())
        return posixpath.relpath(there, posixpath.dirname(place(path)) or ".")

    def _put(self, name: str, content: bytes) -> None:
        target = self.folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)

    def locate(self, page: str, text: str) -> str:
        """The file and line in the repository of a text in a page of the site's source."""
        origin = self.origins.get(page)
        shown = origin or f"{page} (generated)"
        lines = (self.folder / page).read_text(encoding="utf-8").splitlines()
        numbers = [number for number, line in enumerate(lines, 1) if text in line]
        return f"{shown}:{numbers[0]}" if numbers else shown


def repository_pages(root: Path) -> list[str]:
    """The repository's pages that are part of the site, as POSIX paths."""
    found = [*root.glob("docs/**/*.md"), *root.glob("studies/**/*.md")]
    return sorted([*(path.relative_to(root).as_posix() for path in found), *SINGLE])


def assets(root: Path) -> Mapping[str, bytes]:
    """The files in `docs` that are not pages: pictures, styles, scripts."""
    folder = root / "docs"
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != PAGE
    }
