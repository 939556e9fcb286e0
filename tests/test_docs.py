"""README and docs say what is: tables, commands, code, links, versions."""

import json
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import magical
from magical import cli
from tools import check_tag

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "entries/README.md"]
PAGES += [path for folder in ("docs", "studies") for path in sorted((ROOT / folder).rglob("*.md"))]
FOLDERS = ("src", "baselines", "goals", "play", "tests", "benchmarks", "studies", "tools")

# Commands that are quick and need nothing made before; the arguments of the others are parsed here,
# and tests of their own run them.
QUICK = {"envs", "show"}


def blocks(language):
    """Every code block in a language, with its page's name."""
    pattern = re.compile(rf"```{language}\n(.*?)```", re.DOTALL)
    return [(page.name, block) for page in PAGES for block in pattern.findall(page.read_text())]


LINES = [
    line for _, block in blocks("bash") for line in block.replace("\\\n", " ").splitlines() if line
]
COMMANDS = list(filter(None, (shlex.split(line, comments=True) for line in LINES)))
# Blocks that a page names as files, such as `# my_bc.py`.
FILES = {
    match[1]: block for _, block in blocks("python") if (match := re.match(r"# (\w+\.py)\n", block))
}


@pytest.mark.parametrize("argv", [w[1:] for w in COMMANDS if w[0] == "magical"], ids=" ".join)
def test_magical_commands_work(argv, tmp_path, monkeypatch):
    if argv[0] == "train":
        pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name, code in FILES.items():
        Path(name).write_text(code)
    if argv[0] in QUICK:
        assert cli.main(argv) == 0
    else:
        cli.build_parser().parse_args(argv)


def test_other_commands_exist():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for words in COMMANDS:
        if words[0] == "make":
            assert words[1] in targets
        elif words[:2] == ["python", "-m"]:
            assert (ROOT / words[2].replace(".", "/")).with_suffix(".py").is_file()
        elif words[0] == "python":
            assert (ROOT / words[1]).is_file()
        else:
            assert words[0] == "magical" or words[:2] == ["pip", "install"]


# Training takes minutes; test_examples.py runs those blocks with less of everything.
@pytest.mark.parametrize(
    ("page", "code"), [block for block in blocks("python") if "magical_baselines" not in block[1]]
)
def test_python_blocks_run(page, code, tmp_path):
    if "torch" in code:
        pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    if "magical_goals" in code:
        pytest.importorskip("magical_goals", reason="magical-goals is not installed")
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


def test_links_lead_somewhere():
    links = [
        (page, target)
        for page in PAGES
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text())
        if not target.startswith("https://")
    ]
    assert [link for link in links if not (link[0].parent / link[1]).exists()] == []


def keys(value):
    """Of an object that was read as JSON, and of all objects in it."""
    if isinstance(value, dict):
        return set(value).union(*map(keys, value.values()))
    return set().union(*map(keys, value)) if isinstance(value, list) else set()


@pytest.mark.parametrize(
    "words",
    [
        "envs",
        "show magical/MoveToRegion-Demo-v0",
        "evaluate noop --task MoveToRegion --variants Demo --rollouts 1 --workers 0",
        "demos generate --env magical/MoveToRegion-Demo-v0 -n 1 --out demos",
    ],
)
def test_objects_of_json_have_the_documented_keys(words, tmp_path, monkeypatch, capsys):
    page = (ROOT / "docs" / "scripting.md").read_text()
    rows = dict(re.findall(r"^\| `([^|]+)` \| (.*) \|$", page, re.MULTILINE))
    (documented,) = (cell for command, cell in rows.items() if words.startswith(command))
    monkeypatch.chdir(tmp_path)
    assert cli.main([*words.split(), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(re.findall("`([a-z_]+)`", documented)) <= keys(found)


def test_cited_sections_of_the_specification_exist():
    page = (ROOT / "docs" / "specification.md").read_text()
    sections = set(re.findall(r"^## (\d+)\. ", page, re.MULTILINE))
    citation = r"docs/specification\.md,\s+(?:# )?sections?\s+((?:\d+(?:,\s+| and | to )?)+)"
    texts = [path.read_text() for name in FOLDERS for path in (ROOT / name).rglob("*.py")]
    cited = {n for text in texts for found in re.findall(citation, text) for n in found.split()}
    cited = {number for word in cited for number in re.findall(r"\d+", word)}
    assert cited == sections


def test_generated_tables_are_up_to_date():
    tool = runpy.run_path(str(ROOT / "tools" / "readme_tables.py"))
    assert tool["main"](["--check"]) == 0, "run python tools/readme_tables.py"


def test_the_results_are_up_to_date():
    from studies import pages

    assert pages.main(["--check"]) == 0, "run python -m studies.pages"


def test_paper_presets_have_what_the_appendix_states():
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    from magical_baselines import find_algorithm
    from magical_baselines.config import options
    from tools import preset_tables

    for name in preset_tables.SOURCES:
        kind = find_algorithm(name).config
        stated = preset_tables.appendix(kind)
        paper = {option.name: option.default for option in options(kind)} | kind.presets["paper"]
        assert len(stated) >= 10
        assert {field: paper[field] for field in stated} == stated


def test_one_version_everywhere():
    assert f"\nversion: {magical.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert check_tag.disagreements(f"v{magical.__version__}", magical.__version__, changelog) == []


@pytest.mark.parametrize(
    ("tag", "changelog", "message"),
    [
        ("v1.0", "## [1.1] - 2026-01-02", "expected the tag v1.1"),
        ("", "## [1.1] - 2026-01-02", "found none"),
        ("v1.1", "## [1.0] - 2026-01-02", "expected 1.1 at the top of the changelog, found 1.0"),
        ("v1.1", "## [1.1] - unreleased", "expected the date of 1.1"),
    ],
)
def test_a_tag_that_disagrees_is_refused(tag, changelog, message):
    (found,) = check_tag.disagreements(tag, "1.1", changelog)
    assert message in found


def test_the_steps_of_workflows_are_targets_of_make():
    targets = re.findall(r"^([a-z-]+):.*##", (ROOT / "Makefile").read_text(), re.MULTILINE)
    text = "".join(file.read_text() for file in (ROOT / ".github" / "workflows").glob("*.yml"))
    steps = [line.split() for line in re.findall(r"run: (.*)", text)]
    assert {command for command, *_ in steps} == {"make"}
    assert {target for _, target, *_ in steps} <= set(targets)
