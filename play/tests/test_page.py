"""The page's files: nothing from elsewhere, colours that can be read."""

import re

from magical_play.server import PAGE


def test_the_page_loads_nothing_from_elsewhere() -> None:
    for path in PAGE.iterdir():
        text = path.read_text()
        assert re.findall(r"(?:https?:)?//[\w.]+\.\w+", text) == []
        assert not re.search(r"innerHTML|eval\(|<script>|\son\w+=\"", text)


def luminance(code: str) -> float:
    """That of a colour such as `#fff` (WCAG 2.2)."""
    digits = code if len(code) == 6 else "".join(digit * 2 for digit in code)
    parts = [part / 255 for part in bytes.fromhex(digits)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_colours_have_enough_contrast() -> None:
    colours = dict(re.findall(r"--(\w+): #(\w+);", (PAGE / "style.css").read_text()))
    paper = luminance(colours.pop("paper"))
    assert colours.pop("line")  # no text has it
    assert {"ink", "faint", "link", "lit", "good", "bad"} == colours.keys()
    for name, code in colours.items():
        assert (paper + 0.05) / (luminance(code) + 0.05) >= 4.5, name
