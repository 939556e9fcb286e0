"""README and docs say what is: tables, commands, code, links, versions."""

import json
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import magical
from magical import cli
from tools import check_tag

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES += [*sorted((ROOT / "studies").rglob("*.md")), ROOT / "entries/README.md"]
# Pages that `make docs` generates, from the folder `docs`.
GENERATED = re.compile(r"docs/((environments|api|commands|configuration)/.+|leaderboard|errors)")

# Commands that are quick and need nothing made before; the arguments of the others are parsed here,
# and tests of their own run them.
QUICK = {"envs", "show"}


def blocks(language: str) -> Iterator[tuple[str, str]]:
    """Every code block in a language, with its page's name."""
    for page in PAGES:
        for block in re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL):
            yield page.name, block


def command_lines() -> Iterator[list[str]]:
    """Every command in the pages, as words."""
    for _, block in blocks("bash"):
        for line in block.replace("\\\n", " ").splitlines():
            if words := shlex.split(line, comments=True):
                yield words


COMMANDS = list(command_lines())
MAGICAL = [words[1:] for words in COMMANDS if words[0] == "magical"]
# Blocks that a page names as files, such as `# my_bc.py`.
FILES = {
    match[1]: block for _, block in blocks("python") if (match := re.match(r"# (\w+\.py)\n", block))
}
OTHERS = [words for words in COMMANDS if words[0] != "magical"]


@pytest.mark.parametrize("argv", MAGICAL, ids=" ".join)
def test_magical_commands_work(
    argv: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if argv[0] == "train":
        pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name, code in FILES.items():
        Path(name).write_text(code)
    if argv[0] not in QUICK:
        cli.build_parser().parse_args(argv)
        return
    assert cli.main(argv) == 0


@pytest.mark.parametrize("words", OTHERS, ids=" ".join)
def test_other_commands_exist(words: list[str]) -> None:
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
    elif words[:2] == ["python", "-m"]:
        assert (ROOT / words[2].replace(".", "/")).with_suffix(".py").is_file()
    elif words[0] == "python":
        assert (ROOT / words[1]).is_file()
    else:
        assert words[:2] == ["pip", "install"]


# Training takes minutes; test_examples.py runs that block with less of everything.
PROGRAMS = [block for block in blocks("python") if "magical_baselines" not in block[1]]


@pytest.mark.parametrize(("page", "code"), PROGRAMS)
def test_python_blocks_run(page: str, code: str, tmp_path: Path) -> None:
    if "torch" in code:
        pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{page}:\n{code}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        file = (page.parent / target).resolve()
        generated = file.is_relative_to(ROOT) and GENERATED.match(file.relative_to(ROOT).as_posix())
        assert target.startswith("https://") or file.exists() or generated, target


def keys(value: object) -> set[str]:
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
def test_objects_of_json_have_the_documented_keys(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs" / "how-to" / "script.md").read_text()
    rows = dict(re.findall(r"^\| `([^|]+)` \| (.*) \|$", page, re.MULTILINE))
    (documented,) = (cell for command, cell in rows.items() if words.startswith(command))
    monkeypatch.chdir(tmp_path)
    assert cli.main([*words.split(), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(re.findall("`([a-z_]+)`", documented)) <= keys(found)


def cited_sections() -> Iterator[tuple[str, int]]:
    """Every citation of the specification in the code: file and section."""
    numbers = r"docs/specification\.md,\s+(?:# )?sections?\s+((?:\d+(?:,\s+| and | to )?)+)"
    for folder in ("src", "baselines", "goals", "play", "tests", "benchmarks", "studies", "tools"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for found in re.findall(numbers, path.read_text()):
                for section in re.findall(r"\d+", found):
                    yield path.name, int(section)


def test_cited_sections_of_the_specification_exist() -> None:
    page = (ROOT / "docs" / "specification.md").read_text()
    sections = [int(number) for number in re.findall(r"^## (\d+)\. ", page, re.MULTILINE)]
    assert sections == list(range(1, 12))
    cited = list(cited_sections())
    assert {section for _, section in cited} >= {1, 2, 3, 4, 5, 6, 7, 8, 9, 10}
    assert [(name, section) for name, section in cited if section not in sections] == []


def test_generated_tables_are_up_to_date() -> None:
    tool = runpy.run_path(str(ROOT / "tools" / "readme_tables.py"))
    assert tool["main"](["--check"]) == 0, "run python tools/readme_tables.py"


def test_the_results_are_up_to_date() -> None:
    from studies import pages

    assert pages.main(["--check"]) == 0, "run python -m studies.pages"


def test_paper_presets_have_what_the_appendix_states() -> None:
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    from magical_baselines import find_algorithm
    from magical_baselines.config import options
    from tools import preset_tables

    for name in preset_tables.SOURCES:
        kind = find_algorithm(name).config
        stated = preset_tables.appendix(kind)
        assert len(stated) >= 10
        defaults = {option.name: option.default for option in options(kind)}
        paper = {**defaults, **kind.presets["paper"]}
        assert {field: paper[field] for field in stated} == stated


def test_the_readme_has_few_figures_in_a_paragraph() -> None:
    text = re.sub(
        r"```.*?```|\]\([^)]*\)|`[^`]*`", "", (ROOT / "README.md").read_text(), flags=re.DOTALL
    )
    paragraphs = [part for part in text.split("\n\n") if "|" not in part]
    assert [part for part in paragraphs if len(re.findall(r"\d[\d.,]*", part)) > 3] == []


def test_one_version_everywhere() -> None:
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
def test_a_tag_that_disagrees_is_refused(tag: str, changelog: str, message: str) -> None:
    (found,) = check_tag.disagreements(tag, "1.1", changelog)
    assert message in found


def test_the_steps_of_workflows_are_targets_of_make() -> None:
    targets = re.findall(r"^([a-z-]+):.*##", (ROOT / "Makefile").read_text(), re.MULTILINE)
    files = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
    steps = [line for file in files for line in re.findall(r"run: (.*)", file.read_text())]
    assert len(steps) >= len(files)
    assert {step.split()[0] for step in steps} == {"make"}
    assert {step.split()[1] for step in steps} <= set(targets)


def test_workflows_end_in_time_and_newer_ones_replace_them() -> None:
    for file in (ROOT / ".github" / "workflows").glob("*.yml"):
        text = file.read_text()
        assert text.count("timeout-minutes: ") == text.count("runs-on: ") > 0, file
        assert "  cancel-in-progress: true\n" in text, file
