"""The site's source: links lead to what the site has, and what is broken is named by its line."""

from pathlib import Path

import pytest

from tools.site.staging import Source


@pytest.fixture
def source(tmp_path: Path) -> Source:
    """A small repository with a page, a study and an example."""
    root = tmp_path / "repository"
    for name, text in {
        "docs/page.md": "# Page\n\n[study](../studies/one/README.md#answer)\n[gone](gone.md)\n",
        "studies/one/README.md": "[](../../docs/page.md) [](script.py) [](../../docs/made.md)\n",
        "studies/one/script.py": "print()\n",
        "docs/code.md": "```text\n[no link](gone.md)\n```\n[example](../examples/a.py)\n",
        "examples/a.py": "print()\n",
    }.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    generated = {"made.md": "# Made\n", "examples/a.md": "# a.py\n"}
    made = Source(root, tmp_path / "site", generated, {})
    made.write(["docs/code.md", "docs/page.md", "studies/one/README.md"])
    return made


def test_links_are_rewritten_and_what_they_lead_to_is_copied(source: Source) -> None:
    page = (source.folder / "page.md").read_text()
    assert "[study](studies/one/README.md#answer)" in page
    study = (source.folder / "studies/one/README.md").read_text()
    assert study == "[](../../page.md) [](script.py) [](../../made.md)\n"
    assert (source.folder / "studies/one/script.py").is_file()
    code = (source.folder / "code.md").read_text()
    assert code == "```text\n[no link](gone.md)\n```\n[example](examples/a.md)\n"


def test_a_broken_link_is_named_by_file_and_line(source: Source) -> None:
    assert source.problems == ["docs/page.md:4: link to gone.md: no such file"]
    assert source.locate("page.md", "studies/one/README.md") == "docs/page.md:3"
    assert source.locate("made.md", "Made") == "made.md (generated):1"


def test_what_mkdocs_finds_wrong_is_named_by_file_and_line(source: Source, tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the docs extra is not installed")
    from tools.site.__main__ import loaded_from_elsewhere, located

    for message in (
        "Doc file 'page.md' contains a link 'studies/one/README.md', but ...",
        "mkdocs_autorefs: page.md: Could not find cross-reference target 'gone'",
    ):
        assert located(source, message).startswith(("docs/page.md:3: ", "docs/page.md:4: "))
    site = tmp_path / "built"
    site.mkdir()
    (site / "a.html").write_text('<a href="https://a.org">a</a> <img src="b.png">')
    (site / "b.html").write_text('<link rel="x" href="https://a.org/b.css">')
    (found,) = loaded_from_elsewhere(site)
    assert found.startswith("b.html: loads from another host: ")
