"""SIGKILL for random processes of a run, and closed terminals: the same command finishes it, and all recordings are as
without."""

from __future__ import annotations

import os
import pty
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
from tests.processes import described

TRIALS, KILLS, HANGUPS = 40, 50, 5
"""Even: half of the trials are of one task, half of another."""
STRETCH = 3.0
"""How much longer the attacks take, all together, than the undisturbed run: each throws away what had begun, and the
rest must still get on."""
LAST = 0.75
GONE_S = 1.0
"""After the death of the command."""

HELPER = f"4321.{os.getpid()}"
POLICY = f"""
import os
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

def help():
    # In a session of its own, without the variables that the policy was given, by a shell that ends.
    os.system("env -i setsid sleep {HELPER} & exit 0")

class P:
    card = PolicyCard(name="helped")
    def __init__(self):
        help()
    def reset(self, instruction):
        help()
    def act(self, observation):
        return Action()
"""

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


def started_in(temporary: Path) -> list[int]:
    """The processes that have this folder for temporary files, as far as this user may know: also those that began
    after the last look at the tree."""
    found: list[int] = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.fsencode(temporary) in (folder / "environ").read_bytes():
                found.append(int(folder.name))
    return found


def helpers() -> list[int]:
    """What the policies started, also that which no attack saw."""
    found: list[int] = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if HELPER.encode() in (folder / "cmdline").read_bytes() and int(folder.name) != os.getpid():
                found.append(int(folder.name))
    return found


def command(out: Path, trials: int) -> list[str]:
    seeds = ["--seeds", f"0-{trials // 2 - 1}", "--set", "phases.time_limit_s=1", "--jobs", "2", "--out", str(out)]
    return [sys.executable, "-m", "carecontact", "run", "--policy", "mine:P", "--tasks", "T1,T2", *seeds]


def within(temporary: Path) -> dict[str, str]:
    return {**os.environ, "TMPDIR": str(temporary)}


class Terminal:
    """One that a command is started in, and that may be closed under it."""

    def __init__(self, arguments: list[str], temporary: Path) -> None:
        self._ours, theirs = pty.openpty()
        os.set_blocking(self._ours, False)
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), theirs)
        ctty = ["setsid", "--ctty", *arguments]
        self.running = subprocess.Popen(ctty, **streams, env=within(temporary), cwd=temporary.parent)
        os.close(theirs)

    def wait(self, seconds: float) -> bool:
        """Whether the command has ended then. Reads what it prints, for which it would wait."""
        until = time.monotonic() + seconds
        while self.running.poll() is None and time.monotonic() < until:
            with suppress(OSError):
                os.read(self._ours, 1 << 16)
            time.sleep(0.02)
        return self.running.poll() is not None

    def close(self) -> None:
        if self._ours >= 0:
            os.close(self._ours)
            self._ours = -1


@dataclass
class Attack:
    out: Path
    temporary: Path
    trials: int
    rng: random.Random
    longest_s: float
    """Between two attacks."""
    kills: int
    hangups: int
    """How many are left."""
    killed: int = 0
    commands: int = 0
    supervisors: int = 0
    attacks: int = 0
    """In all."""
    meanwhile: int = 0
    """Trials that had a recording when the last attack began."""
    done: dict[str, int] = field(default_factory=dict[str, int])
    """Recording of a trial that did not fail -> time of its last change [ns]."""

    def __post_init__(self) -> None:
        self.attacks = self.kills + self.hangups

    def once(self) -> int:
        """Give the command and attack it until it ends; returns the exit status."""
        seen, terminal = set[Process](), Terminal(command(self.out, self.trials), self.temporary)
        self.commands += 1
        pid = terminal.running.pid
        while not terminal.wait(self.rng.uniform(0.0, self.pause_s())):
            if self.kills + self.hangups == 0 or not (found := tree(pid)):
                continue
            seen |= set(found)
            if len(found) == 1 and self.rng.random() < 0.8:
                continue  # more often while it has workers than while it begins
            self.meanwhile = len(list(self.out.glob("*.h5")))
            if self.rng.randrange(self.kills + self.hangups) < self.hangups:
                terminal.close()
                self.hangups -= 1
                assert terminal.wait(GONE_S + 10.0)
                break
            victim = self.rng.choice(found)
            with suppress(ProcessLookupError):
                os.kill(victim[0], signal.SIGKILL)
                self.killed, self.kills = self.killed + 1, self.kills - 1
                self.supervisors += victim[0] == pid
        terminal.close()
        time.sleep(GONE_S)
        assert not [described(process[0]) for process in seen if alive(process)]
        assert not started_in(self.temporary)
        assert not [described(pid) for pid in helpers()]
        self.look()
        return terminal.running.returncode

    def pause_s(self) -> float:
        """Long while the run is behind the attacks, so that it gets on; short while it is ahead of them, so that all of
        them are made by the time when LAST of its trials are done."""
        made = 1.0 - (self.kills + self.hangups) / self.attacks
        behind = len(list(self.out.glob("*.h5"))) <= LAST * made * self.trials
        return self.longest_s if behind else self.longest_s / 10

    def look(self) -> None:
        for name, changed in self.done.items():
            assert (self.out / name).stat().st_mtime_ns == changed, f"{name} was done and ran again"
        for path in self.out.glob("*.h5"):
            if read_recording(path).header.failure is None:
                self.done[path.name] = path.stat().st_mtime_ns


def hashes(out: Path) -> dict[str, str]:
    return {path.name: read_recording(path).stored_sha256 for path in out.glob("*.h5")}


@pytest.mark.slow
@pytest.mark.usefixtures("sandbox")
def test_what_was_killed_at_random_is_finished_by_the_same_command(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    def given(name: str, usual: int) -> int:
        return int(os.environ.get(name, usual))

    trials, hangups = given("KILL_TRIALS", TRIALS), given("KILL_HANGUPS", HANGUPS)
    undisturbed, temporary = tmp_path / "undisturbed", tmp_path / "temporary"
    temporary.mkdir()
    (tmp_path / "mine.py").write_text(POLICY)
    shared = set(Path("/dev/shm").iterdir())
    kills, began = given("KILL_KILLS", KILLS), time.monotonic()
    subprocess.run(
        command(undisturbed, trials), check=True, stdout=subprocess.DEVNULL, env=within(temporary), cwd=tmp_path
    )
    longest_s = 2.0 * STRETCH * (time.monotonic() - began) / (kills + hangups)
    attack = Attack(tmp_path / "run", temporary, trials, random.Random(7), longest_s, kills, hangups)
    while attack.kills + attack.hangups and len(attack.done) < trials:
        attack.once()
    assert attack.kills + attack.hangups == 0, "the run ended before all attacks were made"
    assert attack.meanwhile > trials // 4, "else there was hardly a trial that could have run again or been lost"
    attack.kills = attack.hangups = 0
    assert attack.once() == 0
    assert hashes(attack.out) == hashes(undisturbed)
    assert {path.name for path in attack.out.iterdir()} == {path.name for path in undisturbed.iterdir()}
    assert not list(temporary.iterdir())
    assert set(Path("/dev/shm").iterdir()) <= shared
    counts = {"kills": attack.killed, "of the command": attack.supervisors, "commands": attack.commands}
    record_property("random kills", {**counts, "trials": trials, "done meanwhile": attack.meanwhile})
