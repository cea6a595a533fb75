"""Links, commands, numbers and words of README and docs."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import carecontact
from carecontact.cli.parsing import COMMANDS, parse
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.policies.registry import role_of
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.recording.notes import JOINTS
from carecontact.runs.scoring import read_scores
from carecontact.scoring.foam import LEAST_MMHG, PASSES
from carecontact.sim.opengl import PACKAGES
from carecontact.tissue.binary import PLATFORMS
from tests.report.browser import Browser, found
from tests.serving.fakes import Openpi, OpenpiPositions

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"(?<!`)\[[^\]]*\]\(([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "CHANGELOG.md", ROOT / "client/README.md"], ids=lambda page: str(page.relative_to(ROOT))
)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for target in LINK.findall(page.read_text()):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        place = (page.parent / path).resolve() if path else page
        assert place.exists(), target
        assert not anchor or anchor in anchors(place), target


def test_the_readme_links_to_every_page() -> None:
    linked = set(re.findall(r"\((docs/[^)#]+\.md)", (ROOT / "README.md").read_text()))
    assert linked >= {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").glob("*.md")}


def test_the_page_of_evidence_links_to_every_page_beside_it() -> None:
    linked = set(LINK.findall((ROOT / "docs/evidence/README.md").read_text()))
    assert linked == {path.name for path in (ROOT / "docs/evidence").glob("*.md")} - {"README.md"}


SOURCES = ("src/**/*.py", "src/**/*.toml", "src/**/*.j2", "examples/**/*.*", "client/*.md", "tools/**/*.py", "*.toml")


def test_every_page_that_code_and_messages_name_exists() -> None:
    files = [path for pattern in SOURCES for path in ROOT.glob(pattern) if path.suffix != ".pyc"]
    named = {page for path in files for page in re.findall(r"\bdocs/[a-z/0-9-]+\.md\b", path.read_text())}
    assert len(named) > 10
    assert not [page for page in sorted(named) if not (ROOT / page).exists()]


# Every command in a block of code is one that the program understands, and every page names one exam.

EXAM = "bathing-wide-v2"


def page_commands() -> list[tuple[Path, str]]:
    found: list[tuple[Path, str]] = []
    for page in PAGES:
        text = page.read_text()
        blocks = [*re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S), *re.findall(r"(?:^    .*\n)+", text, re.M)]
        lines = "\n".join(textwrap.dedent(block).replace("\\\n", " ") for block in blocks).splitlines()
        found += [(page, line) for line in lines if line.startswith("carecontact ")]
    return found


def words_of(line: str) -> list[str]:
    return shlex.split(line.partition(" | ")[0], comments=True)[1:]


@pytest.mark.parametrize(
    ("page", "line"), page_commands(), ids=lambda part: part if isinstance(part, str) else part.stem
)
def test_the_program_understands_every_command_of_the_pages(page: Path, line: str) -> None:
    command = words_of(line)
    parse(command)
    if "--protocol" in command or EXAM in command:
        name = command[command.index("--protocol") + 1] if "--protocol" in command else EXAM
        level = command[command.index("--level") + 1] if "--level" in command else None
        load_protocol(name, level=level or ("L0" if name == EXAM else None))


def test_the_pages_name_one_exam() -> None:
    for page in PAGES:
        ids = set(re.findall(r"bathing-wide-v\d(?:-draft)?", page.read_text()))
        assert page.parent.name == "results" or ids <= {EXAM, "bathing-wide-v1"}, page


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "docs/number.md"], ids=lambda page: page.stem)
def test_the_rates_on_l2_are_those_of_the_kept_runs(page: Path) -> None:
    rows = dict(re.findall(r"^\| `([a-z-]+)`.*\| (\d+ \(\d+ %\)) \|$", page.read_text(), re.M))
    folder = ROOT / "docs/results" / f"{EXAM}-L2"
    runs = {policy: read_scores(folder / f"{policy}.json.gz").scores for policy in rows}
    passed = {policy: sum(score.safety_gated for score in scores) for policy, scores in runs.items()}
    assert rows == {name: f"{passed[name]} ({100 * passed[name] / len(runs[name]):.0f} %)" for name in runs}
    blind = [path for path in folder.glob("*.gz") if role_of(path.name.partition(".")[0]) == "blind"]
    best = max(sum(score.safety_gated for score in read_scores(path).scores) for path in blind)
    assert passed["mean-person-hybrid"] == best, "the floor is the best blind baseline"


ACTIONS = ("touch", "scrub", "push")


def _shown(name: str, value: float) -> str:
    """A value of a gate as the page writes it: lengths in mm, shares in percent."""
    if name.endswith("_m"):
        return f"{1000 * value:g} mm"
    return f"{100 * value:g} %" if name.endswith("_share") else f"{value:g}"


def test_the_gates_of_the_tasks_page_are_those_of_the_exam() -> None:
    rules = load_protocol(EXAM, level="L2")
    gates = rules.gates.model_dump()
    touch, scrub, push = ({name: _shown(name, value) for name, value in gates[action].items()} for action in ACTIONS)
    cleaned = _shown("cleaned_share", gates["foam"]["cleaned_share"])
    page = (ROOT / "docs/tasks.md").read_text()
    for row in (
        f"| touch | a held force of {touch['least_n']} to {touch['most_n']} N for {touch['duration_s']} s without",
        f"| scrub | {cleaned} of the foam is cleaned: passed {PASSES} times with at least {LEAST_MMHG:g} mmHg (on L0, "
        f"without foam: {scrub['passed_m']} of the region's axis are passed {scrub['passes']} times with at least "
        f"{scrub['least_n']} N); {scrub['least_n']} to {scrub['most_n']} N during {scrub['band_share']} of the time",
        f"| push | at least {push['force_n']} N for {push['duration_s']} s without interruption; the wrist moves by "
        f"{push['least_wrist_m'].partition(' ')[0]} to {push['most_wrist_m']} from",
    ):
        assert row in page


# Words: as few as the limits of tools/words.py, in sentences that are understood at first reading.


BANNED = re.compile(r"\b(told|nobody|whoever|anew)\b", re.IGNORECASE)


@pytest.fixture(scope="module")
def words() -> ModuleType:
    spec = importlib.util.spec_from_file_location("words", ROOT / "tools" / "words.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("group", ["pages", "evidence", "results"])
def test_the_documentation_stays_short(words: ModuleType, group: str) -> None:
    assert sum(words.count(page.read_text()) for page in words.pages(group)) <= words.LIMITS[group]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_are_short_and_in_the_terms_of_the_field(words: ModuleType, page: Path) -> None:
    text = page.read_text()
    assert words.mean_length(text) <= words.MEAN_SENTENCE
    assert not BANNED.findall(text)


def test_docstrings_are_in_the_terms_of_the_field(words: ModuleType) -> None:
    assert not BANNED.findall(words.docstrings())


def test_sentences_are_counted_without_code_and_tables(words: ModuleType) -> None:
    prose = "# A heading of words\n\nOne two three. Four five six\nseven `eight`.\n\n- One [two three](x.md) four\n"
    text = f"{prose}\n| a | b c d |\n\n```\nx y z\n```\n"
    assert [words.count(sentence) for sentence in words.sentences(text)] == [3, 5, 5]


def test_the_glossary_has_at_most_thirty_terms() -> None:
    rows = re.findall(r"^\| (?!term|-)", (ROOT / "docs/glossary.md").read_text(), re.M)
    assert 10 < len(rows) <= 30


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 130


# The website of the documentation builds without a warning, shows what the code has, and loads nothing elsewhere.


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; mkdocs is strict, so that a warning fails the build."""
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
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


@pytest.mark.slow
def test_no_page_requests_anything_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 25
    for page in pages:
        loaded = _Loaded()
        loaded.feed(page.read_text())
        assert loaded.addresses
        assert not [address for address in loaded.addresses if "//" in address], page


@pytest.mark.slow
def test_every_command_has_its_help(site: Path) -> None:
    page = (site / "commands.html").read_text()
    for name in COMMANDS:
        assert f'id="{name.replace(" ", "-")}"' in page
        assert f"carecontact {name}" in page


@pytest.mark.slow
def test_the_python_reference_shows_docstrings(site: Path) -> None:
    page = (site / "reference/python.html").read_text()
    assert 'id="carecontact.api.run.load"' in page
    assert 'id="carecontact.episode.episode.Episode.reset"' in page


@pytest.mark.slow
def test_a_linked_file_of_the_repository_is_there(site: Path) -> None:
    page = (site / "your-policy.html").read_text()
    copy = re.search(r'href="(files/examples/standalone_policy\.py\.txt)"', page)
    assert copy
    assert (site / copy[1]).read_text() == (ROOT / "examples/standalone_policy.py").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "page_found"),
    [("indentation", "scores.html"), ("--shard", "machines.html"), ("contact window", "glossary.html")],
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
        page = browser.open(site / "reference" / "python.html")
        answer = page.call("Runtime.evaluate", expression=search, returnByValue=True, awaitPromise=True)
        assert any(page_found in hit for hit in answer["result"]["value"])
        assert not [address for address in page.requests if not address.startswith(("file:", "data:"))]


def test_the_tasks_page_has_every_task_of_the_paper() -> None:
    page = (ROOT / "docs/tasks.md").read_text()
    for task in load_protocol("bathing-v3").tasks:
        assert f"| {task.id} | {task.action} | {task.region.replace('_', ' ')} | {task.prompt} |" in page


# The commands for pi0.5 in docs/vla.md, against a stand-in where the page has a machine with a GPU.

PAGE = (Path(__file__).parents[1] / "docs" / "vla.md").read_text(encoding="utf-8").replace("\\\n", " ")
PI05_PAGE_COMMANDS = [
    shlex.split(line)[1:]
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
    if line.startswith("carecontact ")
]
RUNS = [command for command in PI05_PAGE_COMMANDS if command[0] == "run"]


def test_the_page_has_a_run_of_each_profile_and_a_check() -> None:
    assert {command[0] for command in PI05_PAGE_COMMANDS} == {"run", "check"}
    for profile in ("pi05-droid", "pi05-droid-jointpos"):
        assert any(f"openpi://GPU-HOST:8000?profile={profile}" in command for command in RUNS)


@pytest.mark.parametrize("command", PI05_PAGE_COMMANDS, ids=" ".join)
def test_every_command_is_understood(command: list[str]) -> None:
    assert type(parse(command)).__name__.lower() == command[0]


@pytest.mark.parametrize(
    "command",
    [pytest.param(run, marks=[] if "--latency-ms" in run else pytest.mark.slow, id=" ".join(run)) for run in RUNS],
)
def test_every_run_completes_a_short_trial(command: list[str], tmp_path: Path) -> None:
    server = OpenpiPositions() if "jointpos" in " ".join(command) else Openpi(steps=15)
    with server.running() as port:
        here = [part.replace("GPU-HOST:8000", f"127.0.0.1:{port}") for part in command]
        short = ["--tasks", "T1", "--seeds", "0", "--set", "phases.time_limit_s=1.5"]
        done = subprocess.run(
            [sys.executable, "-m", "carecontact", *here, *short], cwd=tmp_path, capture_output=True, text=True
        )
    assert done.returncode == 0, done.stdout + done.stderr
    out = tmp_path / command[command.index("--out") + 1]
    (trial,) = json.loads((out / "results.json").read_text())["trials"]
    assert trial["ended"] == "time_limit"
    late = "--latency-ms" in command
    assert ("phases.latency_s" in trial.get("overrides", {})) is late


# tools/perception_table.py: measured rows are kept only for what they were measured with.

TOOLS = Path(__file__).parents[1] / "tools"


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(TOOLS))
    import perception_table

    return perception_table


def made_rows(seed: int, *, body: str, target_m: float, found_on_wrist: bool = False) -> list[dict[str, Any]]:
    row = {
        "seed": seed, "body": body, "tone": "tan", "region": "", "somebody": True, "sure": 33,
        "error_px": [4.0] * len(JOINTS), "visible": [True] * len(JOINTS), "iou": 0.99,
        "target_m": [[target_m, 0.0, 0.0]] * len(STANDARD_REGIONS),
    }  # fmt: skip
    over = [{**row, "condition": "over", "region": region} for region in STANDARD_REGIONS]
    wrist = {**row, "condition": "wrist", "somebody": found_on_wrist, "sure": 21, "error_px": [229.0] * 2 + [None] * 10}
    return [{**row, "condition": "parked"}, {**row, "condition": "noise"}, wrist, *over]


def test_a_scene_is_measured_again_when_what_it_was_measured_with_changed(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    measured: list[int] = []

    def measure(protocol: Any, seed: int, keypoints: object) -> list[dict[str, Any]]:
        measured.append(seed)
        return made_rows(seed, body=protocol.person.body, target_m=0.01)

    rows = tmp_path / "rows.jsonl"
    # As rows were before they carried a fingerprint.
    rows.write_text("".join(json.dumps(row) + "\n" for row in made_rows(6000, body="man-adult", target_m=0.9)))
    monkeypatch.setattr(tool, "scene_rows", measure)
    monkeypatch.setattr(tool, "Remembering", lambda: None)
    monkeypatch.setattr(sys, "argv", ["perception_table.py", "--seeds", "6000-6001", "--rows", str(rows)])
    tool.main()
    assert measured == [6000, 6001]
    tool.main()
    assert measured == [6000, 6001]
    monkeypatch.setattr(tool, "PACKAGES", ("numpy",))
    tool.main()
    assert measured == [6000, 6001, 6000, 6001]


def test_the_fingerprint_follows_rules_body_and_code(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rules = load_protocol("bathing-v3")
    first, seen = tool.fingerprint(rules), Path.read_bytes
    assert tool.fingerprint(rules) == first
    assert tool.fingerprint(overridden(rules, {"person.body": "man-old-heavy"})) != first
    assert tool.fingerprint(rules.model_copy(update={"description": "another"})) != first
    for part in tool.SOURCES:
        source = Path(carecontact.__file__).parent / part
        edited = source if source.is_file() else next(source.rglob("*.py"))
        with monkeypatch.context() as patch:
            patch.setattr(Path, "read_bytes", lambda path, e=edited: seen(path) + b"#" * (path == e))
            assert tool.fingerprint(rules) != first, part


def test_groups_that_miss_a_line_are_named_though_the_pool_holds_it(tool: ModuleType) -> None:
    rows = [row for seed in range(3) for row in made_rows(seed, body="man-adult", target_m=0.008)]
    rows += made_rows(3, body="man-old-heavy", target_m=0.021, found_on_wrist=True)
    text = tool.tables(rows)
    assert "Missed lines: none." in text
    assert "| man-old-heavy | 1 | 4.0 | 0.990 | 21.0 | 21.0 | 21.0 |" in text
    assert "Over 15 mm by themselves: man-old-heavy forearm 21.0, man-old-heavy upper arm 21.0" in text
    assert "From the wrist camera, robot parked: somebody in 1 of 4 scenes, with 21 to 21 landmarks" in text
    assert "229 to 229 px off" in text


# The image is made by the same tools, of the same packages, as the environment of a clone. No image is built here.

TEXT = (ROOT / "Dockerfile").read_text()


def test_it_uses_the_uv_of_the_bootstrap() -> None:
    version = re.search(r"^UV_VERSION=(\S+)", (ROOT / "tools/bootstrap.sh").read_text(), re.MULTILINE)
    assert version
    assert f"uv=={version[1]}" in TEXT


def test_it_installs_what_rendering_needs() -> None:
    assert all(package in TEXT for package in PACKAGES["egl"].split())


def test_the_build_context_has_what_the_build_reads() -> None:
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [word for line in re.findall(r"^COPY (?!--from)(.+) \S+$", TEXT, re.MULTILINE) for word in line.split()]
    assert kept == set(copied)
    assert all((ROOT / path).exists() for path in kept if not path.startswith("dist/"))


def test_the_image_gets_a_wheel_by_the_name_that_the_build_gives_it() -> None:
    named = re.search(r'dist/carecontact-\*-(\S+?)"\$\(uname -m\)"\.whl', TEXT)
    assert named
    tags = [platform.tag for name, platform in PLATFORMS.items() if name.startswith("linux")]
    assert {tag.removeprefix(named[1]) for tag in tags} == {"x86_64", "aarch64"}


def test_hadolint_finds_nothing() -> None:
    hadolint = shutil.which("hadolint", path=str(Path(sys.executable).parent))
    assert hadolint, "hadolint is in the group dev: run make env"
    found = subprocess.run([hadolint, str(ROOT / "Dockerfile")], capture_output=True, text=True)
    assert found.returncode == 0, found.stdout
