"""What the website has beyond the pages of docs/: the README as its first page, references made from the code, and
copies of the files outside docs/ that pages link to.

mkdocs.yml names this file; mkdocs calls the functions whose names begin with ``on_``.
"""

from __future__ import annotations

import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parent))
from board import board_tables, entries, entry_page
from references import commands_help, python_page

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(\]\()([^)\s#]+)(#[^)\s]*)?(\))")
HOME = "README.md"
SHIM = re.compile(r'src="https://unpkg\.com/iframe-worker/[^"]*"')
"""What the theme loads from a content network so that its search works on pages that are opened from a folder."""
WORKER = "frame_worker.js"
"""Our own script for the same, in the folder of this file and at the root of the site."""
BOOST = {
    "glossary.md": 4.0, "number.md": 3.0, "scores.md": 3.0, "tasks.md": 2.0,
    "reference/python.md": 0.5, "results/release-0.1.0.md": 0.3,
}  # fmt: skip
"""Page -> how much its hits in the search count; EVIDENCE for the pages of evidence, 1 for the others."""
EVIDENCE = 0.3
SHARE = re.compile(r"(?<=<td>)(\d+) (\([\d.]+) (%\))(?=</td>)")
"""A number of trials with its percentage, alone in a cell."""
PAGE_NAME = re.compile(r"\bdocs/([a-z0-9/-]+)\.md\b")
COPIES = "files"
"""Folder of the site with copies of linked files of the repository."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and every file of the repository that a page links to and docs/ does not have."""
    generated = {
        "index.md": _home(),
        "reference/python.md": python_page(),
        **{f"board/{stem}.md": entry_page(stem, entry) for stem, entry in entries().items()},
    }
    for path, text in generated.items():
        files.append(File.generated(config, path, content=text))
    files.append(File.generated(config, WORKER, content=(Path(__file__).parent / WORKER).read_text()))
    for page in [file for file in files if file.is_documentation_page()]:
        for target in _outside(page.src_uri, page.content_string):
            if files.get_file_from_path(_copied(target)) is None:
                files.append(_copy(config, target))
    return files


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """Let links to files outside docs/ lead to their copies, weigh the page in the search, and add what is
    generated: commands' help, and the tables of the board."""
    folder = posixpath.dirname(page.file.src_uri)
    boost = BOOST.get(page.file.src_uri, EVIDENCE if folder == "evidence" else 1.0)
    if boost != 1.0:
        page.meta["search"] = {"boost": boost}
    if page.file.src_uri == "commands.md":
        markdown += "\n" + commands_help()
    if page.file.src_uri == "board.md":
        before, heading, after = markdown.partition("## Submit")
        markdown = f"{before}{board_tables(entries())}\n{heading}{after}"

    def changed(link: re.Match[str]) -> str:
        target = _leaves(folder, link[2])
        if target is None:
            return link[0]
        if target == HOME:
            return f"{link[1]}{posixpath.relpath('index.md', folder or '.')}{link[3] or ''}{link[4]}"
        return f"{link[1]}{posixpath.relpath(_copied(target), folder or '.')}{link[4]}"

    return LINK.sub(changed, markdown)


def on_page_content(html: str, *, page: Page, **_: Any) -> str:
    """Keep a number and its percentage on one line; in the reference, link the pages that docstrings name."""
    html = SHARE.sub(r"\1&nbsp;\2&nbsp;\3", html)
    return PAGE_NAME.sub(r'<a href="../\1.html">\1</a>', html) if page.file.src_uri == "reference/python.md" else html


def on_post_page(output: str, *, page: Page, **_: Any) -> str:
    """Let the search of a page run without a request to another host."""
    return SHIM.sub(f'src="{posixpath.relpath(WORKER, posixpath.dirname(page.file.dest_uri) or ".")}"', output)


def on_post_template(output_content: str, *, template_name: str, **_: Any) -> str:
    """The same for the page that a web server shows for a wrong address, whose links begin at the site's root."""
    return SHIM.sub(f'src="/{WORKER}"', output_content) if template_name.endswith(".html") else output_content


def _home() -> str:
    """The README, whose links start at the root of the repository."""

    def moved(link: re.Match[str]) -> str:
        target = link[2]
        if "://" in target:
            return link[0]
        inside = target.removeprefix("docs/") if target.startswith("docs/") else f"../{target}"
        return f"{link[1]}{inside}{link[3] or ''}{link[4]}"

    return LINK.sub(moved, (ROOT / HOME).read_text())


def _outside(page: str, markdown: str) -> list[str]:
    folder = posixpath.dirname(page)
    found = [_leaves(folder, link[2]) for link in LINK.finditer(markdown)]
    return sorted({target for target in found if target not in (None, HOME)})


def _leaves(folder: str, target: str) -> str | None:
    """Path in the repository of a link that leaves docs/ or leads to a folder; None for any other link."""
    if "://" in target:
        return None
    path = posixpath.normpath(posixpath.join("docs", folder, target))
    return None if path.startswith("docs/") and not (ROOT / path).is_dir() else path


def _copied(target: str) -> str:
    # A browser shows a file named .txt; it would download the others.
    return f"{COPIES}/{target}.txt"


def _copy(config: MkDocsConfig, target: str) -> File:
    path = ROOT / target
    text = "\n".join(sorted(each.name for each in path.iterdir())) if path.is_dir() else path.read_text()
    return File.generated(config, _copied(target), content=text)
