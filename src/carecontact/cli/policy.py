"""From the options about a policy to its setup; checked before a run, since every trial would fail in the same way."""

from __future__ import annotations

import ast
import difflib
import fcntl
import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from carecontact.cli.console import excerpt
from carecontact.cli.groups import PolicyGroup, VisionGroup
from carecontact.errors import ConfigError, ContractError, PolicyError, UnknownNameError
from carecontact.interface.policy import API_KEY, LOOK_CONTROLS, PolicyCard, PolicyRef, check_arguments, check_variables
from carecontact.policies.language.live import language_name
from carecontact.policies.registry import POLICIES, is_privileged
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.recording.reason import reason
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import open_policy

SPELLED = {"rules-v1": "rules-v1", "replay": "replay:FILE.jsonl", "live": "live:MODEL"}
"""Kind of language backend -> how a command line names one."""


def chosen_language(ref: PolicyRef, options: PolicyGroup, arguments: dict[str, str]) -> tuple[str | None, str | None]:
    """Return ``language`` and ``record`` with absolute paths, from their options or out of ``arguments``, or None."""
    kinds = POLICIES[ref.name].languages if ref.kind == "registered" else ()
    language, record = options.language, options.record
    if kinds:
        language = _one("language", language, arguments.pop("language", None))
        place = _one("record", None if record is None else str(record), arguments.pop("record", None))
        record = None if place is None else Path(place)
    if record is not None:
        if not (language or "").startswith("live:"):
            raise ConfigError("--record needs --language live:MODEL")
        _check_record(record)
    if language is None:
        return None, None
    kind, colon, place = language.partition(":")
    if ref.kind == "registered" and kind not in kinds:
        valid = " or ".join(SPELLED[kind] for kind in kinds) or "no --language"
        raise ConfigError(f"--language {language}: policy {ref} takes {valid}")
    if kind == "replay" and not place:
        raise ConfigError(f"--language {language}: expected a file after it, as in replay:answers.jsonl")
    spelled = f"replay:{os.path.abspath(place)}" if kind == "replay" and colon else language
    language_name(spelled)
    return spelled, None if record is None else os.path.abspath(record)


def _one(name: str, option: str | None, argument: str | None) -> str | None:
    if option is not None and argument is not None:
        raise ConfigError(f"--{name} and --policy-arg {name}= mean the same; give only one of them")
    return argument if option is None else option


def _check_record(record: Path) -> None:
    folder = record.absolute().parent
    if not folder.is_dir():
        raise ConfigError(f"--record {record}: the folder {record.parent} does not exist")
    if record.exists() and not record.is_file():
        raise ConfigError(f"--record {record}: expected a new or regular file, got a folder, pipe or device")
    try:
        # Trials append to it at the same time.
        with tempfile.TemporaryFile(dir=folder) as beside:
            fcntl.flock(beside, fcntl.LOCK_EX)
    except OSError as error:
        why = f"no file in its folder can be written and locked ({error.strerror})"
        raise ConfigError(f"--record {record}: {why}; name a file on another mount") from None


def suggestion(policy: str, folder: Path) -> str:
    """Guess, from the files of a folder, which policy was meant, and import nothing. Return `` (did you mean
    my_policy:MyPolicy?)``, or an empty text if no file of the folder has a similar name.

    Args:
        policy: as it was typed: a name, ``my_policy.py``, ``my_policy.MyPolicy``, ``my_policy:MyPolcy`` or
            ``folder/my_polcy.py:MyPolicy``.
        folder: where modules are looked for first.
    """
    dotted, _, wanted = policy.partition(":") if ":" in policy else _last_part(policy)
    if dotted.endswith(".py"):
        file = (folder / dotted).resolve()
        if not file.is_relative_to(folder.resolve()):
            names = " or ".join(f"{file.stem}:{name}" for name in classes(file)[:3])
            return f" (did you mean {names}, given in the folder {file.parent}?)" if names else ""
        dotted = str(file.relative_to(folder.resolve()))
    place, _, module = dotted.removesuffix(".py").replace("/", ".").lstrip(".").rpartition(".")
    folder = folder.joinpath(*place.split("."))
    close = difflib.get_close_matches(module, sorted(path.stem for path in folder.glob("*.py")), n=1)
    found = classes(folder / f"{close[0]}.py") if close else []
    if not found:
        return ""
    target = f"{place}.{close[0]}".lstrip(".")
    nearest = difflib.get_close_matches(wanted, found, n=1) or found
    names = " or ".join(f"{target}:{name}" for name in nearest[:3] if f"{target}:{name}" != policy)
    return f" (did you mean {names}?)" if names else ""


def _last_part(policy: str) -> tuple[str, str, str]:
    """Split ``my_policy.MyPolicy``, which has a dot where the colon belongs. The name of a file is not split."""
    if policy.endswith(".py") or "." not in policy:
        return policy, "", ""
    return policy.rpartition(".")


def classes(file: Path) -> list[str]:
    """Return the classes of a module that have a method ``act``, or all classes if none has."""
    with suppress(OSError, SyntaxError, ValueError):
        made = [node for node in ast.parse(file.read_bytes()).body if isinstance(node, ast.ClassDef)]
        acting = [node.name for node in made if any(getattr(part, "name", "") == "act" for part in node.body)]
        return acting or [node.name for node in made]
    return []


def with_vision(protocol: Protocol, options: VisionGroup) -> Protocol:
    """Return the protocol with the options' segmenter; load its models once, as every trial would fail alike."""
    segmenter, weights = options.segmenter, options.weights
    name = segmenter or protocol.vision.segmenter
    if name == "mediapipe":
        if weights is not None:
            raise ConfigError(f"--weights {weights}: only --segmenter grounded-sam takes weights")
        return overridden(protocol, {"vision.segmenter": name, "vision.weights_sha256": ""})
    if weights is None:
        raise ConfigError("--segmenter grounded-sam: also give --weights DIR, a folder with grounding-dino/ and sam/")
    from carecontact.sensing.grounded_sam import GroundedSam, weights_sha256

    try:
        sha256 = weights_sha256(weights)
        GroundedSam(weights)
    except ConfigError as error:
        raise ConfigError(f"--weights {error}") from None
    named = protocol.vision.weights_sha256
    if segmenter is None and sha256 != named:
        raise ConfigError(
            f"--weights {weights}: sha256 {sha256[:12]}, protocol {protocol.name} names {named[:12]}; add "
            "--segmenter grounded-sam to use these weights instead"
        )
    return overridden(protocol, {"vision.segmenter": name, "vision.weights_sha256": sha256})


CREDENTIALS = "CARECONTACT_POLICY_CREDENTIALS"
"""Environment variable for USER:PASSWORD of a remote policy, which keeps them out of the shell's history."""
NOT_FOUND = re.compile(r"ModuleNotFoundError|ImportError")
CLOSED = ("CARECONTACT_", "PYTHON")
"""Beginnings of the names of variables that never reach a policy: the harness's own, and those that would undo the
isolation of the process."""


def policy_setup(policy: str, options: PolicyGroup, variant: str = "") -> PolicySetup:
    """Return the setup of a policy, in a variant, that is looked for in the current folder first."""
    try:
        ref = PolicyRef.parse(policy)
    except ConfigError as error:
        raise ConfigError(f"{error}{suggestion(policy, Path.cwd())}") from None
    if variant in LOOK_CONTROLS and is_privileged(ref):
        raise ConfigError(f"--control {variant}: {ref} is given the simulation, and no picture or reading of the arm")
    if ref.variant:
        raise ConfigError(f"policy {policy}: name {ref.name}, and ask for {ref.variant} by the option of that name")
    try:
        return _setup(ref.with_variant(variant) if variant else ref, options)
    except UnknownNameError as error:
        if nearest := suggestion(policy, Path.cwd()):
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
    and for a privileged one, which no process but a trial's own may start. Print a warning if it is not isolated."""
    if is_privileged(setup.ref):
        if setup.arguments or setup.environment or setup.readable or setup.writable:
            raise ConfigError(
                f"{setup.ref} is privileged and runs in the trial's own process: leave out --policy-arg, --policy-env, "
                "--policy-read and --policy-write"
            )
        return None
    conversation = open_policy(setup, first_deadline_s=deadline_s, deadline_s=deadline_s)
    shipped = setup.ref.kind == "registered" and POLICIES.package(setup.ref.name) is None
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
        nearest = suggestion(setup.ref.text, Path.cwd()) if NOT_FOUND.search(str(error)) else ""
        first = f"--policy {setup.ref} {where}: {why}{nearest}; `carecontact check` shows all of it"
        raise ConfigError("\n".join([first, *excerpt(str(error))])) from None
    level, _, why = (conversation.isolation or "").partition(": ")
    if level == "none":
        print(
            f"warning: {setup.ref} runs without isolation: {why}; run policies that you do not trust on another host "
            "(docs/trust.md)",
            flush=True,
        )
    return card


def arguments_text(setup: PolicySetup) -> str:
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
