"""A strict reader of the pages: what a validator of HTML would say of the elements that they use."""

from __future__ import annotations

from html.parser import HTMLParser

VOID = {"meta", "img", "br", "input", "link", "hr"}
PHRASING = {
    "a", "b", "br", "button", "i", "img", "input", "label", "option", "output", "select", "span", "sub", "svg", "video",
}  # fmt: skip
FLOW = {
    "article", "details", "div", "dl", "figure", "footer", "form", "h1", "h2", "h3", "header", "main", "nav", "ol", "p",
    "pre", "script", "section", "summary", "table", "ul", "figcaption",
}  # fmt: skip
ONLY = {
    "html": {"head", "body"}, "head": {"meta", "title", "style"}, "ul": {"li"}, "ol": {"li"}, "dl": {"dt", "dd"},
    "table": {"thead", "tbody"}, "thead": {"tr"}, "tbody": {"tr"}, "tr": {"th", "td"}, "select": {"option"},
}  # fmt: skip
"""Element -> the only elements that may stand directly in it."""
TEXT_ONLY = {"title", "style", "script", "option", "text"}
PARENT = {"li": {"ul", "ol"}, "summary": {"details"}, "figcaption": {"figure"}, "td": {"tr"}, "th": {"tr"}}
DRAWN = {"path", "rect", "circle", "polyline", "polygon", "text", "tspan", "image"}
SMALL = {"p", "h1", "h2", "h3", "span", "a", "b", "label", "button", "sub", "pre", "dt", "output", "i"}
"""Elements that hold phrasing content alone."""


class StrictReader(HTMLParser):
    """Collects faults, and the elements in their order."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.faults: list[str] = []
        self.elements: list[tuple[str, str]] = []
        """(tag, tag of its parent)"""
        self._open: list[str] = []
        self._ids: set[str] = set()
        if not text.startswith("<!DOCTYPE html>\n"):
            self.faults.append("no doctype")
        self.feed(text)
        self.close()
        self.faults += [f"<{tag}> is never closed" for tag in self._open]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._check(tag, attrs)
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._check(tag, attrs)
        if "svg" not in self._open:
            self.faults.append(f"<{tag}/> outside a drawing")

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open[-1] != tag:
            self.faults.append(f"</{tag}> closes <{self._open[-1] if self._open else ''}> at {self.getpos()}")
        else:
            self._open.pop()

    def handle_data(self, data: str) -> None:
        if data.strip() and self._open and (self._open[-1] in ONLY or self._open[-1] == "svg"):
            self.faults.append(f"text {data.strip()[:20]!r} in <{self._open[-1]}>")

    def _check(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        parent = self._open[-1] if self._open else ""
        self.elements.append((tag, parent))
        names = [name for name, _ in attrs]
        wording = dict(attrs)
        self.faults += [f"<{tag}> has {name} twice" for name in set(names) if names.count(name) > 1]
        if (id_ := wording.get("id")) is not None:
            if not id_ or " " in id_ or id_ in self._ids:
                self.faults.append(f"id {id_!r} of <{tag}> is empty, spaced or not the only one")
            self._ids.add(id_)
        if tag == "img" and not (wording.get("alt") and wording.get("src")):
            self.faults.append("<img> without src and alt")
        known = tag in PHRASING | FLOW | set(ONLY) | TEXT_ONLY | VOID | DRAWN | {"body", "li", "dt", "dd", "td", "th"}
        if not known:
            self.faults.append(f"<{tag}> is not an element that these pages use")
        allowed = ONLY.get(parent)
        if (
            (allowed is not None and tag not in allowed)
            or (parent in SMALL and tag not in PHRASING and not (parent == "summary" and tag in {"h2", "h3"}))
            or parent in TEXT_ONLY - {"text"}
            or (parent == "svg" and tag not in DRAWN)
            or (tag not in DRAWN and "svg" in self._open)
            or (tag in PARENT and parent not in PARENT[tag])
            or (tag == "a" and "a" in self._open)
        ):
            self.faults.append(f"<{tag}> in <{parent}> at {self.getpos()}")
