"""What decided the numbers of a sweep: protocols, tasks, seeds, releases and hashes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import TYPE_CHECKING

from carecontact import __version__
from carecontact.errors import counted
from carecontact.reports.text import listed
from carecontact.runs.plan import compact

if TYPE_CHECKING:
    from carecontact.reports.sweep.table import SweepTable

HEADS = ("what", "value")
DIGITS = 12
"""Number of digits of a hash that tables show."""
WORLD = ("world", "kernel", "perception", "noise", "robot", "mujoco")
"""Parts of the simulated world that every trial of a sweep shares."""


def provenance(table: SweepTable) -> list[list[str]]:
    """Return rows under HEADS; those of which nothing is known are left out."""
    scores = [score for row in table.rows for score in row.cell.scores]
    protocols = {score.protocol_title: score.protocol_sha256[:DIGITS] for score in scores}
    titles = {row.cell.label: score.policy_title for row in table.rows for score in row.cell.scores}
    versions: dict[str, set[str]] = {}
    for row in table.rows:
        for package, found in row.cell.versions.items():
            versions.setdefault(package, set()).update(found)
    definitions = {f"{name} {version}" for s in scores for name, version in s.metric_versions.items()}
    worlds = {f"{name} {s.world[name][:DIGITS]}" for s in scores for name in WORLD if name in s.world}
    rows = {
        "plan": table.title,
        "protocols, with their hashes": listed([f"{title} ({sha256})" for title, sha256 in protocols.items()]),
        "policies": listed([name if name == title else f"{name}: {title}" for name, title in titles.items()]),
        "tasks": ", ".join(sorted({score.task_id for score in scores})),
        "seeds": compact({score.seed for score in scores}),
        "recordings": _recordings(score.recording_sha256 for score in scores),
        "world": ", ".join(sorted(worlds)),
        "definitions of the scores": ", ".join(sorted(definitions)),
        "recorded with": ", ".join(f"{name} {' and '.join(sorted(versions[name]))}" for name in sorted(versions)),
        "table written by": f"carecontact {__version__}",
    }
    return [[what, value] for what, value in rows.items() if value]


def _recordings(hashes: Iterable[str]) -> str:
    """Return how many values there are, and one hash of the hashes of all of them, whatever their order."""
    found = sorted(hashes)
    if not found:
        return ""
    together = hashlib.sha256("\n".join(found).encode("ascii")).hexdigest()
    return f"{counted(len(found), 'trial')}; hash of the hashes of all {together[:DIGITS]}"
