"""pymunk's private interface: used in one file, in the versions that it was tested with."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pymunk
import pytest

import magical
from magical.errors import DependencyVersionError
from magical.physics import chipmunk

PACKAGE = Path(magical.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
PRIVATE_USER = PACKAGE / "physics" / "chipmunk.py"
HANDLES = {"_space", "_body", "_shape", "_constraint"}  # what pymunk's objects wrap
PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"


@pytest.mark.parametrize("version", ["7.3.0", "7.3.1", "7.3.12", pymunk.version])
def test_versions_in_the_tested_range(version: str) -> None:
    chipmunk.check_version(version)


@pytest.mark.parametrize("version", ["6.11.1", "7.2.0", "7.4.0", "7.10.0", "8.0.0", "7.4rc1"])
def test_a_version_outside_it_says_what_to_install(version: str) -> None:
    with pytest.raises(DependencyVersionError) as error:
        chipmunk.check_version(version)
    assert str(error.value) == (
        "expected pymunk >= 7.3 and < 7.4, which this package was tested with, found "
        f"{version}; pip install 'pymunk>=7.3,<7.4'"
    )


@pytest.mark.skipif(not PYPROJECT.exists(), reason="pyproject.toml is only in the repository")
def test_pyproject_has_the_same_range() -> None:
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    low, high = (".".join(map(str, bound)) for bound in chipmunk.TESTED_VERSIONS)
    assert f"pymunk>={low},<{high}" in project["dependencies"]


def private_uses(source: str) -> Iterator[str]:
    """Imports of pymunk's private modules, and private attributes of what may be pymunk's."""
    tree = ast.parse(source)
    modules = set(re.findall(r"^\s*(?:import|from) (pymunk[\w.]*)", source, re.MULTILINE))
    yield from (module for module in modules if "._" in module)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and re.match("_[^_]", node.attr):
            own = isinstance(node.value, ast.Name) and node.value.id in {"self", "cls"}
            if not own and (modules or node.attr in HANDLES):
                yield f"line {node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize(
    "source",
    [
        "from pymunk._chipmunk_cffi import lib",
        "    import pymunk._chipmunk_cffi",
        "import pymunk\nprint(body._id_counter)",
        "print(simulation.robot.body._body)",
    ],
)
def test_a_private_use_is_found(source: str) -> None:
    assert list(private_uses(source.strip()))


def test_the_private_interface_is_used_in_one_file() -> None:
    assert list(private_uses(PRIVATE_USER.read_text(encoding="utf-8")))
    for path in SOURCES:
        if path != PRIVATE_USER:
            assert not list(private_uses(path.read_text(encoding="utf-8"))), path
