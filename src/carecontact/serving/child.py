"""What runs in a policy's isolated process: it raises the import wall, constructs the policy, reports the port and
serves."""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import NotRequired, TypedDict, cast

from carecontact.errors import ConfigError
from carecontact.interface.policy import Policy
from carecontact.serving.arguments import bind, load_factory
from carecontact.serving.process_tree import give_stack
from carecontact.serving.server import serve_policy, traceback_text
from carecontact.system import is_exhausted

OPEN = (
    "carecontact.errors",
    "carecontact.system",
    "carecontact.registry",
    "carecontact.interface",
    "carecontact.policies",
    "carecontact.serving",
)
"""The modules of carecontact that a policy may import; a new module is closed until it is named here."""
_OPEN_PREFIXES = tuple(f"{part}." for part in OPEN)


class ImportWall(MetaPathFinder):
    """A wall against accidents: a policy in this process cannot import the world that it is judged in."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """Raise ImportError for mujoco and for every part of carecontact that is not in OPEN."""
        top, _, part = fullname.partition(".")
        if top == "mujoco" or (top == "carecontact" and part and not f"{fullname}.".startswith(_OPEN_PREFIXES)):
            raise ImportError(
                f"{fullname} is closed to policies: a policy sees only its observations, never the simulation or the "
                f"scorer; it may import {', '.join(OPEN)} and packages other than mujoco",
                name=fullname,
            )
        return None


def raise_wall() -> None:
    """Install the wall. Raises RuntimeError if a closed module is loaded already: the wall could not close it."""
    wall = ImportWall()
    for name in list(sys.modules):
        try:
            wall.find_spec(name, None)
        except ImportError as error:
            raise RuntimeError(f"loaded before the import restrictions were in place: {error}") from None
    sys.meta_path.insert(0, wall)


class Options(TypedDict):
    """What the parent writes to this process's standard input, as JSON."""

    root: str
    """Folder of the package carecontact."""
    target: str
    """``module:Class`` or ``module:function``."""
    search_path: list[str]
    arguments: dict[str, str]
    """Arguments of the constructor or factory; the card shows them."""
    language: dict[str, str]
    """The arguments ``language`` and ``record``, which the card does not show: its language backend names the model."""
    environment: list[str]
    """Names of the variables that --policy-env let pass; the card shows them."""
    report_fd: int
    """File descriptor to which this process writes two JSON lines. ``{"isolation": text}`` comes before anything of the
    policy is imported, so that the policy cannot change it; then ``{"port": n}`` or
    ``{"error": text, "kind": kind}``."""
    lifeline_fd: int
    """Socket of the process that watches this one. It reaches its end when the harness closes the other one or ends."""
    lock_fd: int | None
    """Descriptor of the lock on the policy's temporary folder, for the same process; None if that is in memory."""
    harness_port: int
    """Port of the loopback interface from which the harness connects; connections from any other port are refused."""
    readable: list[str]
    writable: list[str]
    """Files and folders that the user opened to the isolated process for writing."""
    closed: list[str]
    """Folders that must stay closed to it."""
    isolated: bool
    namespaces: bool
    """Whether namespaces are part of the isolation."""
    isolation: NotRequired[str]
    """How far this process isolated itself, as recordings hold it."""
    stack_fd: int
    """File descriptor to which this process writes its stack on request and when the interpreter crashes."""


RECEIVED: dict[str, object] = {}
"""The options that this process received; the audit's witness reports them."""


def main(options: Options) -> None:
    """Construct the policy behind the wall and serve it."""
    RECEIVED.update(options)
    give_stack(options["stack_fd"])
    arguments = options["arguments"]
    with os.fdopen(options["report_fd"], "w", buffering=1) as report:

        def write(**line: object) -> None:
            report.write(f"{json.dumps(line)}\n")

        def listening(port: int) -> None:
            write(port=port)
            report.close()

        write(isolation=options.get("isolation"))
        try:
            raise_wall()
            sys.path[:0] = options["search_path"]
            policy = _construct(options["target"], {**arguments, **options["language"]})
        except ConfigError as error:
            # Its message is for the user who gave the arguments, be it ours or the policy's own.
            write(error=str(error), kind="argument")
            return
        except (Exception, SystemExit) as error:
            write(error=f"could not load {options['target']}:\n{traceback_text(error)}", kind="start")
            return
        try:
            serve_policy(
                policy,
                on_port=listening,
                client_port=options["harness_port"],
                arguments=arguments,
                environment=tuple(options["environment"]),
            )
        except Exception as error:
            if not is_exhausted(error):
                raise
            # Others may have used up the threads or the memory: end as the kernel ends a process without memory.
            traceback.print_exc()
            os.kill(os.getpid(), signal.SIGKILL)


def _construct(target: str, arguments: Mapping[str, str]) -> Policy:
    factory = load_factory(target)
    policy = factory(**bind(factory, arguments))
    missing = [method for method in ("reset", "act") if not callable(getattr(policy, method, None))]
    if missing:
        raise TypeError(f"{target} has no method {' or '.join(missing)}; a policy has card, reset and act")
    return cast(Policy, policy)
