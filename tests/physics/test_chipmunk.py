"""pymunk's private interface: used in one file, in the versions that it was tested with."""

import re
import tomllib
from pathlib import Path

import pymunk
import pytest

import magical
from magical.errors import DependencyVersionError
from magical.physics import chipmunk

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


def test_the_private_interface_is_used_in_one_file() -> None:
    package = Path(magical.__file__).parent
    private = re.compile(r"(pymunk\._\w+|(?<!self)\._(?:space|body|shape|constraint)\b)")
    users = [path for path in package.rglob("*.py") if private.search(path.read_text("utf-8"))]
    assert users == [package / "physics" / "chipmunk.py"]
