"""The board: the tables of its page, and a page for each entry, made from board/*.json and the kept scores."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from pydantic import ValidationError

from carecontact.cli.board import Beside, BoardEntry, BoardLevel, Passes, Share, best_beside
from carecontact.errors import ConfigError
from carecontact.protocol.load import load_levels, shipped_protocols
from carecontact.protocol.lock import frozen_state
from carecontact.runs.results_file import first_error
from carecontact.runs.scoring import read_scores
from carecontact.runs.submission import TEST_SEEDS

ROOT = Path(__file__).resolve().parents[2]
KINDS = {"vision": "vision only", "trained-on-simulation": "trained on simulation", "served": "served"}
COLUMNS = ("method", "passes", "scrubs", "touches, pushes", "harmless", "seconds: policy / trial")
EMPTY = "No entry yet. Yours can be the first: see [how to submit](#submit)."


def entries(folder: Path = ROOT / "board") -> dict[str, BoardEntry]:
    """Return the entries by the names of their files. Raises ConfigError, which names the file, for one that no
    `carecontact submit` wrote."""
    found: dict[str, BoardEntry] = {}
    for path in sorted(folder.glob("*.json")):
        try:
            found[path.stem] = BoardEntry.model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise ConfigError(f"{path} is no entry of the board ({first_error(error)}); write it again") from None
    return found


def board_tables(found: dict[str, BoardEntry], results: Path = ROOT / "docs" / "results") -> str:
    """Return a table for each level of each exam, the frozen ones first; drafts stand apart, under a heading that says
    so. The rules of an entry may be older than those of this release; it then has a table of its own."""
    parts = [] if found else [EMPTY]
    rules = [level for id_ in shipped_protocols() for level in load_levels(id_).values()]
    here = {(p.name, p.sha256): frozen_state(p) == "frozen" for p in rules if TEST_SEEDS[0] in p.randomization.seeds}
    own = {(level.protocol, level.protocol_sha256): level.ranked for e in found.values() for level in e.levels}
    for ranked, heading in ((True, "Exam"), (False, "Draft exam")):
        tables = [
            _table(name, sha256, found, results, here=(name, sha256) in here)
            for name, sha256 in sorted(key for key, frozen in {**own, **here}.items() if frozen is ranked)
        ]
        if any(tables):
            apart = "" if ranked else "\n\nThe rules of a draft may still change. These rows rank nothing."
            parts += [f"## {heading}{apart}", *filter(None, tables)]
    return "\n\n".join(parts) + "\n"


def _table(name: str, sha256: str, found: dict[str, BoardEntry], results: Path, *, here: bool) -> str:
    own = [
        (stem, entry, level)
        for stem, entry in found.items()
        for level in entry.levels
        if (level.protocol, level.protocol_sha256) == (name, sha256)
    ]
    kept = [read_scores(path).scores for path in sorted((results / name.replace(" ", "-")).glob("*.json.gz"))]
    kept = [scores for scores in kept if scores[0].protocol_sha256 == sha256]
    floor, ceiling = best_beside("blind", kept), best_beside("privileged", kept)
    # Scores of another release are not kept; its entries hold what stood beside them.
    floor = floor or next((level.floor for _, _, level in own if level.floor), None)
    ceiling = ceiling or next((level.ceiling for _, _, level in own if level.ceiling), None)
    own.sort(key=lambda row: -(row[2].passes.whole.pc or 0.0))
    lines = [_beside_row("ceiling", ceiling)] if ceiling else []
    lines += [_method_row(*row) for row in own]
    lines += [_beside_row("floor", floor)] if floor else []
    title = name if here else f"{name}, rules {sha256[:12]} of another release"
    return f"### {title}\n\n{_html(COLUMNS, lines, cards=True)}" if lines else ""


def _method_row(stem: str, entry: BoardEntry, level: BoardLevel) -> tuple[str, ...]:
    name = f'<a href="board/{stem}.html">{escape(entry.name)}</a><br><small>{KINDS[entry.method]}</small>'
    return name, *_shares(level.passes), f"{_seconds(level.policy_s)} / {_seconds(level.trial_s)}"


def _beside_row(role: str, beside: Beside) -> tuple[str, ...]:
    name = f"<em>{role}: {escape(beside.policy)}</em><br><small>seeds {escape(beside.seeds)}</small>"
    return name, *_shares(beside.passes), ""


def _shares(passes: Passes) -> tuple[str, ...]:
    return _interval(passes.whole), _plain(passes.scrubs), _plain(passes.others), _plain(passes.harmless)


def _plain(share: Share) -> str:
    return "–" if share.pc is None else f"{share.pc:.0f} % <small>({share.n} of {share.of})</small>"


def _interval(share: Share) -> str:
    low, high = share.pc_ci95
    return "–" if share.pc is None else f"<strong>{share.pc:.0f} %</strong> <small>({low:.0f} to {high:.0f})</small>"


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _html(columns: Sequence[str], rows: Iterable[Sequence[str]], *, cards: bool = False) -> str:
    """Return a table. ``cards``: its cells name their columns, so that a narrow screen shows each row as a card."""
    head = "".join(f"<th>{column}</th>" for column in columns)
    body = "".join(
        "<tr>"
        + "".join(f'<td data-label="{c}"><span>{cell}</span></td>' for c, cell in zip(columns, row, strict=True))
        + "</tr>"
        for row in rows
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="{"cards" if cards else "rows"}">{table}</div>'


def entry_page(stem: str, entry: BoardEntry) -> str:
    """Return the page of one entry: what it is, its ladder over the levels, its failures, and how to run it again."""
    link = f'<a href="{escape(entry.link)}">{escape(entry.link)}</a>' if entry.link else "shipped with carecontact"
    arguments = [f"{name}={value}" for name, value in entry.policy_arguments.items()]
    facts = [
        ("method", KINDS[entry.method]),
        ("link", link),
        ("policy", f"<code>{escape(' '.join([entry.policy, *arguments]))}</code>, {entry.origin}"),
        ("receives", escape(", ".join(entry.receives)) or "the encoders alone"),
        ("trained on", escape(", ".join(entry.trained_on)) or "not stated by the card"),
        ("release", escape(entry.release)),
        ("source sha256", f"<code>{escape(entry.policy_sha256 or 'none')[:12]}</code>"),
    ]
    parts = [f"# {escape(entry.name)}", "[All entries](../board.md)", _html(("entry", ""), facts)]
    parts += ["## Ladder", "Passed trials between floor and ceiling, with 95 % intervals over persons."]
    parts += [_ladder(level) for level in entry.levels]
    for level in entry.levels:
        apart = "" if level.ranked else " (draft exam, not ranked)"
        parts += [f"## {level.protocol}{apart}", _level(level), "Run it again on persons that no one knows:"]
        parts.append(f"```\n{rerun(stem, entry, level)}\n```")
    return "\n\n".join(parts) + "\n"


def rerun(stem: str, entry: BoardEntry, level: BoardLevel) -> str:
    """Return the command with which a maintainer runs an entry again under a salt of their own."""
    id_, _, name = level.protocol.partition(" ")
    given = [f"--policy-arg={key}={value}" for key, value in entry.policy_arguments.items()]
    rules = ["--protocol", id_, *(["--level", name] if name else []), "--seeds", f"{TEST_SEEDS[0]}-{TEST_SEEDS[-1]}"]
    lines = (
        ["carecontact", "run", "--policy", entry.policy, *given],
        rules,
        ["--salt-file", "salt.txt", "--out", f"runs/{stem}-again"],
    )
    return " \\\n    ".join(map(shlex.join, lines))


def _ladder(level: BoardLevel) -> str:
    share = level.passes.whole
    marks = [(role, beside.passes.whole.pc) for role, beside in _both(level)]
    ticks = "".join(f'<i class="{role}" style="left:{pc:.1f}%" title="{role} {pc:.0f} %"></i>' for role, pc in marks)
    low, high = share.pc_ci95
    bar = f'<b style="width:{share.pc:.1f}%"></b><u style="left:{low:.1f}%;width:{high - low:.1f}%"></u>{ticks}'
    text = ", ".join([_interval(share), *(f"{role} {pc:.0f} %" for role, pc in marks)])
    return f'<div class="ladder"><span>{escape(level.protocol)}</span><div>{bar}</div><span>{text}</span></div>'


def _level(level: BoardLevel) -> str:
    passes = level.passes
    passed = [
        ("success (C3)", _plain(level.success)),
        ("region-correct", _plain(level.region_correct)),
        ("safety-gated: passed", _interval(passes.whole)),
        ("of scrubs", _plain(passes.scrubs)),
        ("of touches and pushes", _plain(passes.others)),
        *((f"of {escape(task)}", _plain(share)) for task, share in passes.tasks.items()),
        ("harmless", _plain(passes.harmless)),
        *((role, f"{escape(b.policy)}: {_plain(b.passes.whole)}, seeds {escape(b.seeds)}") for role, b in _both(level)),
    ]
    failed = [(escape(mode.replace("_", " ")), str(n)) for mode, n in level.failures.items()]
    causes = [(escape(cause), str(n)) for cause, n in level.causes.items()]
    made = [
        ("seconds: policy / trial, medians", f"{_seconds(level.policy_s)} / {_seconds(level.trial_s)}"),
        ("seeds", escape(level.seeds)),
        ("salt sha256", _salt(level)),
        ("recordings sha256", f"<code>{escape(level.recordings_sha256[:12])}</code>"),
    ]
    tables = [("passed", passed), ("how the other trials failed", failed), ("why", causes), ("made with", made)]
    return "\n\n".join(_html((title, ""), rows) for title, rows in tables if rows)


def _both(level: BoardLevel) -> list[tuple[str, Beside]]:
    return [(role, beside) for role, beside in (("floor", level.floor), ("ceiling", level.ceiling)) if beside]


def _salt(level: BoardLevel) -> str:
    if not level.salt_sha256:
        return "none: published seeds"
    return f"<code>{escape(level.salt_sha256[:12])}</code>, {'revealed' if level.salt_revealed else 'not revealed'}"
