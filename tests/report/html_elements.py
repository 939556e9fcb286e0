"""The elements of a page."""

from html.parser import HTMLParser

VOID = {"meta", "img", "br", "link", "input"}


class Elements(HTMLParser):
    """The elements of a page; fails where one is closed that is not open."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def values(self, name: str, tag: str = "") -> list[str]:
        """An attribute's values, of elements with one tag or of all."""
        return [a[name] for found, a in self.found if name in a and tag in ("", found)]
