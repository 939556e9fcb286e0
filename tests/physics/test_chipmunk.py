"""pymunk's private interface is used in one file."""

import re
from pathlib import Path

import magical


def test_the_private_interface_is_used_in_one_file() -> None:
    package = Path(magical.__file__).parent
    private = re.compile(r"(pymunk\._\w+|(?<!self)\._(?:space|body|shape|constraint)\b)")
    users = [path for path in package.rglob("*.py") if private.search(path.read_text("utf-8"))]
    assert users == [package / "physics" / "chipmunk.py"]
