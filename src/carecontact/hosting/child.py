"""What the policy's isolated process does: raise the wall, construct the policy, report the port, serve, end with its
parent."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Mapping
from typing import NotRequired, TypedDict, cast

from carecontact.contract.policy import Policy
from carecontact.hosting.arguments import ArgumentError, bind, load_factory
from carecontact.hosting.stack import give_stack
from carecontact.hosting.wall import raise_wall
from carecontact.hosting.wire.server import serve_policy
from carecontact.hosting.wire.tracebacks import told


class Options(TypedDict):
    """What the parent writes to this process's standard input, as JSON."""

    root: str
    """Folder of the package carecontact."""
    target: str
    """``module:Class`` or ``module:function``."""
    search_path: list[str]
    arguments: dict[str, str]
    """Of the constructor or factory; these stand in the card."""
    language: dict[str, str]
    """The arguments ``language`` and ``record``, which do not: the card's language backend names the model."""
    environment: list[str]
    """Names, for the card, of the variables that --policy-env let pass."""
    report_fd: int
    """Where this process writes two JSON lines: ``{"isolation": text}`` before anything of the policy is imported, so
    that the policy cannot say something else, then ``{"port": n}`` or ``{"error": text, "kind": kind}``."""
    lifeline_fd: int
    """Ends when the parent does."""
    parent: int
    """Process id."""
    harness_port: int
    """Of the loopback interface: from there the harness connects, and every other connection is refused."""
    readable: list[str]
    writable: list[str]
    """What the user opened to the isolated process."""
    closed: list[str]
    """What must stay closed to it."""
    isolated: bool
    isolation: NotRequired[str]
    """How far this process isolated itself, as recordings hold it."""
    stack_fd: int
    """Where this process writes its stack when it is asked to, and when the interpreter crashes."""


RECEIVED: dict[str, object] = {}
"""The options of this process; the audit's witness reports them."""


def main(options: Options) -> None:
    """Construct the policy behind the wall and serve it."""
    RECEIVED.update(options)
    give_stack(options["stack_fd"])
    threading.Thread(target=_end_with_parent, args=(options["lifeline_fd"],), daemon=True).start()
    arguments = options["arguments"]
    with os.fdopen(options["report_fd"], "w") as report:

        def tell(said: dict[str, str | int]) -> None:
            report.write(json.dumps(said) + "\n")
            report.close()

        report.write(json.dumps({"isolation": options.get("isolation")}) + "\n")
        report.flush()

        try:
            raise_wall()
            sys.path[:0] = options["search_path"]
            policy = _construct(options["target"], {**arguments, **options["language"]})
        except ArgumentError as error:
            tell({"error": str(error), "kind": "argument"})
            return
        except (Exception, SystemExit) as error:
            message = f"could not load {options['target']}:\n{told(error)}"
            tell({"error": message, "kind": "start"})
            return
        serve_policy(
            policy,
            on_port=lambda port: tell({"port": port}),
            client_port=options["harness_port"],
            arguments=arguments,
            environment=tuple(options["environment"]),
        )


def _construct(target: str, arguments: Mapping[str, str]) -> Policy:
    factory = load_factory(target)
    policy = factory(**bind(factory, arguments))
    missing = [method for method in ("reset", "act") if not callable(getattr(policy, method, None))]
    if missing:
        raise TypeError(f"{target} has no method {' or '.join(missing)}; a policy has card, reset and act")
    return cast(Policy, policy)


def _end_with_parent(lifeline_fd: int) -> None:
    """The parent never writes; the read returns when the parent is gone, even if the policy hangs."""
    os.read(lifeline_fd, 1)
    os._exit(1)
