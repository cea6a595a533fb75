"""From the options about a policy to its setup; checked before a run, since every trial would fail in the same way."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from carecontact.cli.excerpt import excerpt
from carecontact.cli.groups import PolicyGroup
from carecontact.cli.language import chosen_language
from carecontact.cli.policy_names import meant
from carecontact.contract.policy import PolicyCard, check_arguments, check_variables
from carecontact.contract.policy_ref import API_KEY, PolicyRef
from carecontact.errors import ConfigError, ContractError, PolicyError, UnknownNameError
from carecontact.hosting.opening import open_policy
from carecontact.hosting.setup import PolicySetup
from carecontact.policies.registry import POLICIES, is_privileged
from carecontact.recording.reason import reason

CREDENTIALS = "CARECONTACT_POLICY_CREDENTIALS"
"""Environment variable for USER:PASSWORD of a remote policy, which keeps them out of the shell's history."""
NOT_FOUND = re.compile(r"ModuleNotFoundError|ImportError")
CLOSED = ("CARECONTACT_", "PYTHON")
"""Beginnings of the names of variables that never reach a policy: the harness's own, and those that would undo the
isolation of the process."""


def policy_setup(policy: str, options: PolicyGroup) -> PolicySetup:
    """Return the setup of a policy that is looked for in the current folder first.

    Raises ConfigError for a malformed reference, argument or variable, for a language that the policy does not take,
    and for options that a remote policy cannot be given; UnknownNameError; DependencyError as ``chosen_language``.
    """
    try:
        ref = PolicyRef.parse(policy)
    except ConfigError as error:
        raise ConfigError(f"{error}{meant(policy, Path.cwd())}") from None
    try:
        return _setup(ref, options)
    except UnknownNameError as error:
        if nearest := meant(policy, Path.cwd()):
            raise ConfigError(f"{error}{nearest}") from None
        raise


def _setup(ref: PolicyRef, options: PolicyGroup) -> PolicySetup:
    if ref.kind == "remote":
        # Refuses whatever else was given.
        return PolicySetup(
            ref=ref if ref.credentials else replace(ref, credentials=_secret(ref)),
            arguments=_arguments(options.policy_arg),
            environment=dict.fromkeys(options.policy_env, ""),
            readable=options.policy_read,
            writable=options.policy_write,
            language=options.language,
            record=None if options.record is None else str(options.record),
        )
    arguments = _arguments(options.policy_arg)
    language, record = chosen_language(ref, options, arguments)
    return PolicySetup(
        ref=ref,
        search_path=(str(Path.cwd()),),
        arguments=arguments,
        environment=_variables(options.policy_env),
        readable=_places("--policy-read", options.policy_read),
        writable=_places("--policy-write", options.policy_write),
        language=language,
        record=record,
    )


def _secret(ref: PolicyRef) -> str:
    """Return the credentials that a remote policy's server may ask for, from the environment variable of its scheme."""
    if ref.scheme == "ws":
        return os.environ.get(CREDENTIALS, "")
    key = os.environ.get(API_KEY, "")
    if not key.isascii() or not key.isprintable():
        raise ConfigError(f"{API_KEY}: expected one line of printable ASCII characters")
    return key


def check_policy(setup: PolicySetup, *, deadline_s: float) -> PolicyCard | None:
    """Start the policy once, just as a trial does, and return its card; None for a shipped one that is given nothing,
    and for a privileged one, which no process but a trial's own may start. Print a warning if it is not isolated.

    Raises UnknownNameError, or ConfigError that says in its first line why a policy does not start or a server shows no
    card, followed by the end of the policy's traceback and output.
    """
    if is_privileged(setup.ref):
        if setup.arguments or setup.environment or setup.readable or setup.writable:
            raise ConfigError(
                f"{setup.ref} is privileged and runs in the trial's own process: leave out --policy-arg, --policy-env, "
                "--policy-read and --policy-write"
            )
        return None
    conversation = open_policy(setup, first_deadline_s=deadline_s, deadline_s=deadline_s)
    shipped = setup.ref.kind == "registered" and POLICIES.package(setup.ref.text) is None
    if shipped and not (setup.arguments or setup.environment or setup.language):
        return None
    conversation.on_wait, conversation.patient = lambda line: print(line, flush=True), True
    try:
        with conversation:
            card = conversation.start()
    except PolicyError as error:
        if error.kind == "argument":
            raise ConfigError(reason(str(error))) from None
        place = f" (looked in {setup.search_path[0]} first)" if setup.ref.kind == "importable" else ""
        where = "does not answer as a policy server" if setup.ref.kind == "remote" else f"does not start{place}"
        why = reason(str(error)).removeprefix(f"policy {setup.ref.text!r} failed at start: ")
        nearest = meant(setup.ref.text, Path.cwd()) if NOT_FOUND.search(str(error)) else ""
        raise ConfigError(
            "\n".join(
                [
                    f"--policy {setup.ref} {where}: {why}{nearest}; `carecontact check` shows all of it",
                    *excerpt(str(error)),
                ]
            )
        ) from None
    level, _, why = (conversation.isolation or "").partition(": ")
    if level == "none":
        print(
            f"warning: {setup.ref} runs without isolation: {why}; run policies that you do not trust on another host "
            "(docs/threat-model.md)",
            flush=True,
        )
    return card


def arguments_text(setup: PolicySetup) -> str:
    """Return the arguments as a line shows them, with a space before each."""
    return "".join(f" {name}={text}" for name, text in setup.arguments.items())


def _arguments(given: Sequence[str]) -> dict[str, str]:
    arguments: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name.isidentifier():
            raise ConfigError(f"--policy-arg {text!r:.80}: expected NAME=VALUE, for example steps=10")
        if name in arguments:
            raise ConfigError(f"--policy-arg: {name} is given twice; give it once")
        arguments[name] = value
    try:
        check_arguments(arguments)
    except ContractError as error:
        raise ConfigError(f"--policy-arg: {str(error).removeprefix('PolicyCard.')}") from None
    return arguments


def _places(option: str, paths: Sequence[str]) -> tuple[str, ...]:
    """Return the paths as absolute ones, which hold in every folder."""
    found = tuple(os.path.abspath(os.path.expanduser(path)) for path in paths)
    absent = next((path for path in found if not os.path.exists(path)), None)
    if absent is not None:
        raise ConfigError(f"{option} {absent}: no such file or folder")
    return found


def _variables(names: Sequence[str]) -> Mapping[str, str]:
    for name in names:
        if name.startswith(CLOSED):
            raise ConfigError(
                f"--policy-env {name}: carecontact never passes variables that begin with {' or '.join(CLOSED)} to a "
                "policy"
            )
        if name not in os.environ:
            raise ConfigError(f"--policy-env {name}: this variable is not set in this shell; export it first")
        # The value may be a secret, so that it is not shown.
        if any("\udc80" <= character <= "\udcff" for character in os.environ[name]):
            raise ConfigError(f"--policy-env {name}: the value of this variable holds bytes that are not UTF-8")
    try:
        check_variables(names)
    except ContractError as error:
        raise ConfigError(f"--policy-env: {str(error).removeprefix('PolicyCard.')}") from None
    return {name: os.environ[name] for name in names}
