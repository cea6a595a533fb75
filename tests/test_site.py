"""The website of the documentation builds without a warning, shows what the code has, and loads nothing elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from carecontact.cli.commands import COMMANDS
from carecontact.protocols import load_protocol
from tests.reports.browser import Browser, found

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; mkdocs is strict, so that a warning fails the build."""
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(folder)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return folder


class _Loaded(HTMLParser):
    """Addresses that a browser requests by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in ("script", "img", "iframe", "source", "video"):
            self.addresses.append(values.get("src") or "")
        if tag == "link" and values.get("rel") != "canonical":
            self.addresses.append(values.get("href") or "")


def test_no_page_requests_anything_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        loaded = _Loaded()
        loaded.feed(page.read_text())
        assert loaded.addresses
        assert not [address for address in loaded.addresses if "//" in address], page


def test_every_command_has_its_help(site: Path) -> None:
    page = (site / "reference/commands.html").read_text()
    for name in COMMANDS:
        assert f'id="{name}"' in page
        assert f"carecontact {name}" in page


def test_the_python_reference_shows_docstrings(site: Path) -> None:
    page = (site / "reference/python.html").read_text()
    assert 'id="carecontact.programs.run.load"' in page
    assert 'id="carecontact.episode.episode.Episode.reset"' in page


def test_a_linked_file_of_the_repository_is_there(site: Path) -> None:
    page = (site / "your-policy.html").read_text()
    copy = re.search(r'href="(files/examples/standalone_policy\.py\.txt)"', page)
    assert copy
    assert (site / copy[1]).read_text() == (ROOT / "examples/standalone_policy.py").read_text()


@pytest.mark.parametrize(
    ("words", "page_found"),
    [("indentation", "scoring.html"), ("--shard", "cluster.html"), ("contact episode", "glossary.html")],
)
def test_the_search_works_on_pages_that_are_opened_from_a_folder(
    site: Path, tmp_path: Path, words: str, page_found: str
) -> None:
    program = found()
    if program is None:
        pytest.skip("no Chromium on this machine")
    search = (
        f"const words = {words!r};"
        + """
    new Promise(resolve => {
      const field = document.querySelector("input[data-md-component=search-query]");
      field.value = words; field.focus(); field.dispatchEvent(new Event("keyup", { bubbles: true }));
      let left = 100;
      const look = () => {
        const hits = [...document.querySelectorAll(".md-search-result__link")].map(link => link.getAttribute("href"));
        if (hits.length || !left--) resolve(hits); else setTimeout(look, 100);
      };
      look();
    })
    """
    )
    with Browser(program, tmp_path / "profile") as browser:
        page = browser.open(site / "reference" / "commands.html")
        answer = page.call("Runtime.evaluate", expression=search, returnByValue=True, awaitPromise=True)
        assert any(page_found in hit for hit in answer["result"]["value"])
        assert not [address for address in page.requests if not address.startswith(("file:", "data:"))]


def test_the_tasks_page_has_every_task_of_the_paper() -> None:
    page = (ROOT / "docs/tasks.md").read_text()
    for task in load_protocol().tasks:
        assert f"| {task.id} | {task.action} | {task.region.replace('_', ' ')} | {task.prompt} |" in page
