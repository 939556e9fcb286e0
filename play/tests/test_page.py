"""The page's files: nothing from elsewhere, colours that can be read."""

import re
from graphlib import TopologicalSorter
from pathlib import Path

import magical

PAGE = Path(magical.__file__).parent / "web" / "page"


def test_the_page_loads_nothing_from_elsewhere() -> None:
    for path in PAGE.iterdir():
        text = path.read_text()
        assert re.findall(r"(?:https?:)?//[\w.]+\.\w+", text) == []
        assert not re.search(r"innerHTML|eval\(|<script>|\son\w+=\"", text)


def test_no_module_imports_one_that_imports_it() -> None:
    imports = {
        path.name: set(re.findall(r'from "./([\w.]+)"', path.read_text()))
        for path in PAGE.glob("*.js")
    }
    assert set(TopologicalSorter(imports).static_order()) == set(imports)  # raises for a circle


def contrast(first: tuple[int, ...], second: tuple[int, ...]) -> float:
    """The ratio of two colours' luminances (WCAG 2.2)."""

    def luminance(colour: tuple[int, ...]) -> float:
        parts = [c / 255 for c in colour]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    lighter, darker = sorted((luminance(first), luminance(second)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def colours() -> dict[str, tuple[int, ...]]:
    """The page's colours by name."""
    style = (PAGE / "style.css").read_text()
    return {
        name: tuple(bytes.fromhex(code if len(code) == 6 else "".join(c + c for c in code)))
        for name, code in re.findall(r"--(\w+): #(\w+);", style)
    }


def test_colours_have_enough_contrast() -> None:
    found = colours()
    assert {"ink", "faint", "link", "lit", "good", "bad", "paper"} <= found.keys()
    for name in found.keys() - {"paper", "line"}:
        assert contrast(found[name], found["paper"]) >= 4.5, name
