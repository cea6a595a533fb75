"""The two commands that set blind replay beside a run, as a shell takes them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from carecontact.protocols import shipped_protocols
from carecontact.protocols.tissue_sets import shipped_tissue_sets
from carecontact.runs.plan import compact
from carecontact.scoring.result import TrialScore

OPTIONS = {
    "person.body": "--body", "person.tissue_set": "--tissue", "scene.tool": "--tool",
    "impedance.translational_n_m": "--stiffness",
}  # fmt: skip
"""Replaced field of the protocol -> the option of ``carecontact run`` that replaces it; ``--set`` replaces others."""


def replay_commands(scores: Sequence[TrialScore], folder: Path, *, trials: bool = False) -> tuple[str, str]:
    """Return the command that runs blind replay under the rules of a run, and the one that writes its report with it.

    Args:
        scores: of the run's trials, at least one; replay runs the tasks and seeds among them.
        folder: of the run, as the command that writes the page names it.
        trials: whether the report writes the pages of the trials as well.
    """
    out = _beside(folder)
    tasks = sorted({score.task_id for score in scores})
    seeds = compact({score.seed for score in scores}).replace(" ", "")
    run = ["carecontact", "run", "--policy", "replay", *rules_options(scores[0])]
    report = ["carecontact", "report", str(folder), *["--trials"] * trials, "--baseline", out]
    return shlex.join([*run, "--tasks", ",".join(tasks), "--seeds", seeds, "--out", out]), shlex.join(report)


def rules_options(score: TrialScore) -> list[str]:
    """Return options of ``carecontact run`` that give the rules of a trial: protocol, level and every replaced field.

    A file that a score does not name stands as ``FILE.toml`` (protocol, tissue), ``FOLDER`` (weights) or ``FILE``
    (salt).
    """
    name, _, level = score.protocol_id.partition(" ")
    found = ["--protocol", name if name in shipped_protocols() else "FILE.toml"]
    found += ["--level", level] if level else []
    for field, value in sorted(score.overrides.items()):
        if field == "lock":
            found.append("--unfrozen")
        elif field == "vision.segmenter":
            model, _, weights = value.partition(" ")
            found += ["--segmenter", model, *(["--weights", "FOLDER"] if weights else [])]
        elif field in OPTIONS:
            # The set of a calibration is a file that the score does not name.
            is_file = OPTIONS[field] == "--tissue" and value not in shipped_tissue_sets()
            found += [OPTIONS[field], "FILE.toml" if is_file else value]
        else:
            found += ["--set", f"{field}={value}"]
    found += ["--allow-rejected"] if score.world.get("rejected_tissue") else []
    return found + (["--salt-file", "FILE"] if score.world.get("salt") else [])


def _beside(folder: Path) -> str:
    """Return a folder for the other run, beside that of this one."""
    if folder.name in ("", ".."):
        return str(folder / ".." / f"{folder.resolve().name}-replay")
    return str(folder.with_name(f"{folder.name}-replay"))
