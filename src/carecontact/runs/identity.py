"""What decides the numbers of a run: policy, files, bodies, kernels, and the lock of a protocol."""

from __future__ import annotations

import hashlib
import importlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata, resources
from importlib.machinery import PathFinder
from importlib.resources.abc import Traversable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from carecontact.errors import ConfigError
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import Baked
from carecontact.policies.language.live import language_name
from carecontact.policies.registry import POLICIES, policy_target
from carecontact.protocol.load import shipped_protocols
from carecontact.protocol.lock import SUFFIX, Lock, lock_path, read_lock
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import DECLARED, package_versions, supplier_versions
from carecontact.tissue.binary import sources_sha256

WHOLE_BYTES = 1 << 26
"""A longer file is sampled: hashing a checkpoint of many gigabytes would take longer than some runs."""
SAMPLES, SAMPLE_BYTES = 64, 1 << 16
"""Blocks of a longer file, evenly spaced from its beginning to its end."""
MAX_FILES = 10_000
"""Largest number of files of a folder; one with more is taken for something other than weights and has no
fingerprint."""


def fingerprints(arguments: Mapping[str, str]) -> dict[str, str]:
    """Argument -> fingerprint, for every argument whose text is the path of a file or folder, from here."""
    found: dict[str, str] = {}
    for name, text in arguments.items():
        try:
            fingerprint = fingerprint_of(Path(text)) if text else None
        except (OSError, ValueError):
            continue  # unreadable, or no path at all: the policy will say so
        if fingerprint is not None:
            found[name] = fingerprint
    return found


def fingerprint_of(path: Path) -> str | None:
    """Return a sha256 over the names, sizes and contents of a file or of all files of a folder. A file longer than
    WHOLE_BYTES counts with SAMPLES blocks of its content, so that a change of a few bytes of it may be missed. None for
    what is neither file nor folder, and for a folder of more than MAX_FILES files."""
    if path.is_file():
        return hashlib.sha256(b"".join(_pieces(path))).hexdigest()
    if not path.is_dir():
        return None
    files = list(islice((file for file in path.rglob("*") if file.is_file()), MAX_FILES + 1))
    if len(files) > MAX_FILES:
        return None
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(str(file.relative_to(path)).encode(errors="surrogateescape") + b"\0")
        digest.update(hashlib.sha256(b"".join(_pieces(file))).digest())
    return digest.hexdigest()


def _pieces(path: Path) -> Iterator[bytes]:
    size = path.stat().st_size
    yield size.to_bytes(8, "little")
    with path.open("rb") as file:
        if size <= WHOLE_BYTES:
            yield file.read()
            return
        for k in range(SAMPLES):
            file.seek(k * (size - SAMPLE_BYTES) // (SAMPLES - 1))
            yield file.read(SAMPLE_BYTES)


class Identity(BaseModel):
    """What besides policy name and protocol decides a run's numbers: trials with different ones must not share a
    folder."""

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
    """``search_path``: where ``module:Class`` is looked for first. ``language``: as the command line spells it."""
    # A command that only reads results loads nothing of the world.
    from carecontact.human.library import SMPLX_PREFIX, smplx_path

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
        policy_sha256=None if source is None else _sha256(source),
        card=card.plain() if card is not None and ref.kind == "remote" else None,
        language=language_name(language) if language else None,
        arguments=spec.policy_arguments,
        argument_files=fingerprints(spec.policy_arguments),
        environment=spec.policy_environment,
        versions={name: versions[name] for name in ("carecontact", "mujoco")}
        | supplier_versions(spec.protocol)
        | policy_package(ref),
        sha256={what: _sha256(path) for what, path in archives.items()}
        | {"robot": spec.protocol.scene.robot.source.sha256},
    )


def _sha256(path: Traversable) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def policy_package(ref: PolicyRef) -> dict[str, str]:
    """Name and version of the installed package whose entry point supplied the policy; empty for any other policy."""
    package = POLICIES.package(ref.name) if ref.kind == "registered" else None
    return {} if package is None else {package: metadata.version(package)}


def policy_source(ref: PolicyRef, *, search_path: Sequence[str]) -> Path | None:
    """Find the file of a policy's module, as its process will, without an import; None where there is no such file."""
    if ref.kind == "remote" or (ref.kind == "registered" and POLICIES.package(ref.name) is None):
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


PACKAGES = ("mujoco", "ai-edge-litert")
"""Their releases change the physics or what is seen; numpy's and scipy's are held by the sums and the score hashes."""
WORLD_FIELDS = (
    *("body_mass", "body_inertia", "body_pos", "geom_size", "geom_pos", "geom_friction", "jnt_pos", "jnt_range"),
    *("jnt_stiffness", "jnt_stiffnesspoly", "dof_damping", "dof_frictionloss", "numeric_data"),
    *("mesh_vert", "skin_vert", "actuator_gainprm", "actuator_biasprm", "cam_pos", "cam_fovy", "light_dir"),
)
"""Fields of the compiled model; ``numeric_data`` has the shells and laws of the tissue. Each gives a sum of magnitudes
and one weighted by place, so that a swap is seen too."""
SAME = 1e-6
"""Relative difference of sums that counts as rounding."""


def make_lock(protocol: Protocol, *, worlds: bool = True) -> Lock:
    """``worlds``: compile the worlds of ``worlds_of`` and sum over each; about a second for each."""
    return Lock(
        id=protocol.name,
        protocol_sha256=protocol.sha256,
        fields=protocol.model_dump(mode="json"),
        embodiment=protocol.scene.robot.id,
        versions={name: version for name, version in package_versions().items() if name in PACKAGES},
        assets=asset_hashes(protocol),
        worlds={name: world_sums(*world) for name, world in (worlds_of(protocol) if worlds else {}).items()},
    )


def asset_hashes(protocol: Protocol) -> dict[str, str]:
    """Return the hashes of the protocol's bodies, their skin, the robot and the C sources of the tissue; files that are
    not there have no entry. The binary of the tissue has none, because it differs between platforms."""
    folder = resources.files("carecontact") / "assets"
    bodies = protocol.variation.bodies or (protocol.person.body,)
    places = [("bodies", f"{body}.{kind}") for body in bodies for kind in ("npz", "skin.png")]
    robot = protocol.scene.robot
    own = f"{robot.source.name}/{robot.source.name}.npz" if isinstance(robot.source, Baked) else robot.id
    files = {f"{place}/{name}": folder / place / name for place, name in places}
    hashes = {name: _sha256(file) for name, file in files.items() if file.is_file()}
    return {"kernel/c": sources_sha256(), **hashes, own: robot.source.sha256}


def worlds_of(protocol: Protocol) -> dict[str, tuple[Protocol, str]]:
    """Name -> protocol and region of the worlds of a lock: each region once, or each body with a region in turn."""
    regions, bodies = protocol.regions, protocol.variation.bodies
    if not bodies:
        return {region: (protocol, region) for region in regions}
    out: dict[str, tuple[Protocol, str]] = {}
    for number, body in enumerate(bodies):
        region, person = regions[number % len(regions)], protocol.person.model_copy(update={"body": body})
        out[f"{region}, {body}"] = protocol.model_copy(update={"person": person}), region
    return out


def world_sums(protocol: Protocol, region: str) -> dict[str, float]:
    from carecontact.world.scene import build_scene

    model = build_scene(protocol, target=region).model
    sums = {"nq": float(model.nq), "nv": float(model.nv), "ngeom": float(model.ngeom), "dt_s": model.opt.timestep}
    for name in WORLD_FIELDS:
        values = np.abs(np.asarray(getattr(model, name), np.float64)).ravel()
        sums[name] = float(values.sum())
        sums[f"{name} by place"] = float(values @ np.linspace(1.0, 2.0, len(values)))
    return sums


def drift(lock: Lock, now: Lock) -> list[str]:
    """Return the differences from the lock, most informative first; worlds only where ``now`` has them."""
    own = [("id", lock.id, now.id), ("embodiment", lock.embodiment, now.embodiment)]
    own.append(("protocol sha256", lock.protocol_sha256[:12], now.protocol_sha256[:12]))
    pairs = [(what, old, new) for what, old, new in own if old != new]
    pairs += [(name, _short(old), _short(new)) for name, old, new in changed(lock.fields, now.fields)]
    for kind, before, after in (("version of", lock.versions, now.versions), ("asset", lock.assets, now.assets)):
        for name, *both in changed(before, after):
            old, new = (str(value or "none")[: 12 if kind == "asset" else None] for value in both)
            pairs.append((f"{kind} {name}", old, new))
    found = [f"{what}: locked {old}, here {new}" for what, old, new in pairs]
    for world, sums in now.worlds.items():
        held = lock.worlds.get(world, {})
        names = sorted(held.keys() | sums.keys())
        old, new = (np.array([known.get(name, np.nan) for name in names]) for known in (held, sums))
        moved = [
            name for name, same in zip(names, np.isclose(old, new, rtol=SAME, atol=1e-12), strict=True) if not same
        ]
        if moved:
            more = f" and {len(moved) - 4} more" if len(moved) > 4 else ""
            found.append(f"world ({world}): {', '.join(moved[:4])}{more}")
    return found


def changed(before: object, after: object, place: str = "") -> Iterator[tuple[str, object, object]]:
    """Yield every place in which two values differ that JSON can hold, with what either has there."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for name in (*before, *(name for name in after if name not in before)):
            yield from changed(before.get(name), after.get(name), f"{place}.{name}" if place else str(name))
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, pair in enumerate(zip(before, after, strict=True)):
            yield from changed(*pair, f"{place}[{number}]")
    elif before != after:
        yield place, before, after


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def lock_of(name_or_path: str, protocol: Protocol) -> Lock | None:
    """Return the lock that holds for a protocol: its own, or the shipped one where a file has its id."""
    return read_lock(protocol.id if is_borrowed(name_or_path, protocol) else name_or_path, level=protocol.level)


def is_borrowed(name_or_path: str, protocol: Protocol) -> bool:
    """Whether a file of the user's has the id of a shipped protocol: one id, one set of rules."""
    return protocol.id in shipped_protocols() and name_or_path != protocol.id


def check_frozen(name_or_path: str, protocol: Protocol, *, unfrozen: bool) -> Protocol:
    """Return the protocol, if it is a draft or equals its lock; quick, so the compiled worlds are left out. With
    ``unfrozen``, its overrides, and so every output, name the differences from the lock."""
    borrowed, lock = is_borrowed(name_or_path, protocol), lock_of(name_or_path, protocol)
    if not protocol.frozen and not (borrowed and lock):
        return protocol
    if lock is None:
        raise ConfigError(
            f"protocol {protocol.id} says frozen = true but has no lock: {lock_path(name_or_path).name} is missing; "
            "restore it, or say frozen = false, or write one with: carecontact protocol lock FILE.toml"
        )
    now = make_lock(protocol, worlds=False)
    differences = drift(lock, now)
    if not differences:
        return protocol
    if not unfrozen:
        others = [f"{name}=={held}" for name, held in lock.versions.items() if now.versions.get(name) != held]
        if borrowed:
            remedy = f"Give {name_or_path} an id of its own"
        elif others:
            remedy = f"Install the locked versions: python -m pip install {' '.join(others)}"
        else:
            remedy = f"Take back what differs from {protocol.id}{SUFFIX}"
        raise ConfigError(
            f"protocol {protocol.id} differs from its lock ({'; '.join(differences)}), so its results would not be "
            f"comparable. {remedy}, or run with --unfrozen; then every output names the differences"
        )
    return protocol.model_copy(update={"overrides": {**protocol.overrides, "lock": "; ".join(differences)}})
