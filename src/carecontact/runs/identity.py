"""What besides policy name and protocol decides a run's numbers: sources, packages and baked assets."""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata, resources
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from carecontact.contract.policy import PolicyCard
from carecontact.contract.policy_ref import PolicyRef
from carecontact.contract.trial import TrialSpec
from carecontact.policies.language.selection import language_name
from carecontact.policies.registry import POLICIES, policy_target
from carecontact.recording.versions import DECLARED, package_versions, supplier_versions
from carecontact.runs.fingerprint import fingerprints


class Identity(BaseModel):
    """Trials with different ones must not share a folder."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    policy_sha256: str | None
    """Hash of the file of the policy's module; None for a policy of this package, for which the version stands, and for
    one on another host, of which nothing is known but its address and card."""
    card: dict[str, Any] | None = None
    """The card of a policy on another host, which is all that can be known of its version."""
    language: str | None = None
    """Backend that --language named; None: the policy's own choice."""
    arguments: dict[str, str] = {}
    """What --policy-arg gave."""
    argument_files: dict[str, str] = {}
    """Argument that names a file or folder -> fingerprint of its content, such as a checkpoint's."""
    environment: tuple[str, ...] = ()
    """Names of the variables that --policy-env let pass."""
    world: dict[str, str] = DECLARED
    """Declared versions of what simulates a trial."""
    versions: dict[str, str]
    sha256: dict[str, str]
    """Hashes of the archives of the body and the robot; keys and values are those of a recording's header."""

    def differences(
        self, *, versions: Mapping[str, str], sha256: Mapping[str, str], world: Mapping[str, str]
    ) -> list[str]:
        """List the differences of this identity from an older one; fields that the older one lacks do not count."""
        pairs = [(name, versions.get(name), now) for name, now in self.versions.items()]
        pairs += [(f"version of the {name}", world.get(name), now) for name, now in self.world.items()]
        pairs += [(f"{name} sha256", sha256.get(name, "")[:12], now[:12]) for name, now in self.sha256.items()]
        return [f"{name} was {old}, is {now}" for name, old, now in pairs if old and old != now]


def identity_of(
    spec: TrialSpec, *, search_path: Sequence[str], language: str | None = None, card: PolicyCard | None = None
) -> Identity:
    """
    Args:
        search_path: folders in which ``module:Class`` is looked for before the installed packages.
        language: as the command line spells it.
        card: what the policy showed when it was tried.
    """
    # Whoever only reads results loads nothing of the world.
    from carecontact.world.human.smplx import SMPLX_PREFIX, smplx_path

    versions = package_versions()
    ref = PolicyRef.parse(spec.policy)
    source = policy_source(ref, search_path=search_path)
    assets = resources.files("carecontact") / "assets"
    drawn, body = spec.protocol.variation.bodies, spec.protocol.person.body
    # A recording names the body of its own trial, and so not those that a seed may draw.
    named = {f"body {name}": name for name in drawn} if drawn else {"body": body}
    archives = {
        what: smplx_path(name) if name.startswith(SMPLX_PREFIX) else assets / "bodies" / f"{name}.npz"
        for what, name in named.items()
    }
    return Identity(
        policy_sha256=None if source is None else hashlib.sha256(source.read_bytes()).hexdigest(),
        card=card.plain() if card is not None and ref.kind == "remote" else None,
        language=language_name(language) if language else None,
        arguments=spec.policy_arguments,
        argument_files=fingerprints(spec.policy_arguments),
        environment=spec.policy_environment,
        versions={name: versions[name] for name in ("carecontact", "mujoco")}
        | supplier_versions(spec.protocol)
        | policy_package(ref),
        sha256={what: hashlib.sha256(path.read_bytes()).hexdigest() for what, path in archives.items()}
        | {"robot": spec.protocol.scene.robot.source.sha256},
    )


def policy_package(ref: PolicyRef) -> dict[str, str]:
    """Name and version of the installed package whose entry point supplied the policy; empty for any other policy."""
    package = POLICIES.package(ref.text) if ref.kind == "registered" else None
    return {} if package is None else {package: metadata.version(package)}


def policy_source(ref: PolicyRef, *, search_path: Sequence[str]) -> Path | None:
    """Find the file of a policy's module as the policy's process will, but without importing it.

    None for a policy of this package, one on another host, and where there is no such file.
    """
    if ref.kind == "remote" or (ref.kind == "registered" and POLICIES.package(ref.text) is None):
        return None
    importlib.invalidate_caches()
    places: Sequence[str] | None = [place for place in (*search_path, *sys.path) if place]
    name, found = "", None
    for part in policy_target(ref).partition(":")[0].split("."):
        name = f"{name}.{part}" if name else part
        found = None if places is None else PathFinder.find_spec(name, list(places))
        if found is None:
            return None
        places = found.submodule_search_locations
    source = Path(found.origin) if found is not None and found.origin else None
    return source if source is not None and source.is_file() else None
