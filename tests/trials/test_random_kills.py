"""SIGKILL for random processes of a run: the same command finishes it, and all recordings are as without."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from carecontact.recording import read_recording
from carecontact.recording.reader import read_verified

TRIALS, KILLS = 12, 15
"""Even: half of the trials are of one task, half of another."""
GONE_S = 1.0
"""After the death of the command."""

Process = tuple[int, str]
"""Id and time of the start, which a process that has the id later does not share."""


def stat(pid: int) -> tuple[str, int, str] | None:
    """State, parent and time of the start."""
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return fields[0], int(fields[1]), fields[19]
    return None


def tree(root: int) -> list[Process]:
    """A process and all that descend from it, root first."""
    found = {int(folder.name): stat(int(folder.name)) for folder in Path("/proc").glob("[0-9]*")}
    inside, out = {root}, list[Process]()
    while more := {pid for pid, row in found.items() if row and row[1] in inside} - inside:
        inside |= more
    for pid in sorted(inside, key=lambda pid: pid != root):
        if (row := found.get(pid)) and row[0] not in "ZX":
            out.append((pid, row[2]))
    return out


def alive(process: Process) -> bool:
    row = stat(process[0])
    return row is not None and row[0] not in "ZX" and row[2] == process[1]


def command(out: Path, trials: int) -> list[str]:
    return [
        sys.executable, "-m", "carecontact.cli", "run", "--policy", "zero-action", "--tasks", "T1,T2",
        "--seeds", f"0-{trials // 2 - 1}", "--set", "phases.time_limit_s=1", "--jobs", "2", "--out", str(out),
    ]  # fmt: skip


@dataclass
class Attack:
    out: Path
    trials: int
    rng: random.Random
    killed: int = 0
    commands: int = 0
    supervisors: int = 0
    done: dict[str, int] = field(default_factory=dict[str, int])
    """Recording of a trial that did not fail -> time of its last change [ns]."""

    def once(self, kills: int) -> int:
        """Give the command, kill up to so many of its processes; returns the exit status."""
        seen = set[Process]()
        with subprocess.Popen(command(self.out, self.trials), stdout=subprocess.DEVNULL) as running:
            self.commands += 1
            while running.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    running.wait(self.rng.uniform(0.3, 2.0))
                if running.poll() is None and kills > 0 and (found := tree(running.pid)):
                    seen |= set(found)
                    if len(found) == 1 and self.rng.random() < 0.8:
                        continue  # more often while it has workers than while it begins
                    victim = self.rng.choice(found)
                    with suppress(ProcessLookupError):
                        os.kill(victim[0], signal.SIGKILL)
                        self.killed, kills = self.killed + 1, kills - 1
                        self.supervisors += victim[0] == running.pid
        time.sleep(GONE_S)
        assert not [process for process in seen if alive(process)]
        self.look()
        return running.returncode

    def look(self) -> None:
        for name, changed in self.done.items():
            assert (self.out / name).stat().st_mtime_ns == changed, f"{name} was done and ran again"
        for path in self.out.glob("*.h5"):
            if read_recording(path).header.failure is None:
                self.done[path.name] = path.stat().st_mtime_ns


def hashes(out: Path) -> dict[str, str]:
    return {path.name: read_verified(path).sha256 for path in out.glob("*.h5")}


@pytest.mark.slow
def test_what_was_killed_at_random_is_finished_by_the_same_command(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    trials, kills = int(os.environ.get("KILL_TRIALS", TRIALS)), int(os.environ.get("KILL_KILLS", KILLS))
    undisturbed = tmp_path / "undisturbed"
    subprocess.run(command(undisturbed, trials), check=True, stdout=subprocess.DEVNULL)
    attack = Attack(tmp_path / "run", trials, random.Random(7))
    while attack.killed < kills and len(attack.done) < trials:
        attack.once(kills - attack.killed)
    # Without a kill, twice: a trial that was killed before its policy ran is repeated by itself.
    attack.once(0)
    status = attack.once(0)
    failed = {
        path.stem: failure
        for path in attack.out.glob("*.h5")
        if (failure := read_recording(path).header.failure) is not None
    }
    # A policy that was killed cannot be told from one that killed itself, so that its trial counts until it is told not
    # to; and a trial whose process was killed in two commands is not repeated a third time.
    assert {failure.kind for failure in failed.values()} <= {"died", "killed", "start", "signal_again"}
    assert (status == 0) == (not failed)
    if failed:
        again = [*command(attack.out, trials), "--retry-failed"]
        subprocess.run(again, check=True, stdout=subprocess.DEVNULL)
        attack.look()
    assert hashes(attack.out) == hashes(undisturbed)
    assert not [path.name for path in attack.out.iterdir() if path.name.startswith(".")]
    told = {"kills": attack.killed, "of the command": attack.supervisors, "commands": attack.commands}
    record_property("random kills", {**told, "trials": trials, "with --retry-failed": len(failed)})
