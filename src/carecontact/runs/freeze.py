"""Determines what a frozen protocol depends on besides its own fields, and how that differs from the protocol's
lock."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from importlib import resources

import numpy as np

from carecontact.contract.embodiment import Baked
from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError
from carecontact.kernel.binary import sources_sha256
from carecontact.protocols import shipped_protocols
from carecontact.protocols.lock import SUFFIX, Lock, lock_path, read_lock
from carecontact.recording.versions import package_versions

PACKAGES = ("mujoco", "mediapipe")
"""Their releases change the physics or what is seen; numpy's and scipy's are held by the sums and the score hashes."""
WORLD_FIELDS = (
    "body_mass", "body_inertia", "body_pos", "geom_size", "geom_pos", "geom_friction", "jnt_pos", "jnt_range",
    "jnt_stiffness", "jnt_stiffnesspoly", "dof_damping", "dof_frictionloss", "numeric_data",
    "mesh_vert", "skin_vert", "actuator_gainprm", "actuator_biasprm", "cam_pos", "cam_fovy", "light_dir",
)  # fmt: skip
"""Fields of the compiled model; ``numeric_data`` has the shells and laws of the tissue. Each gives a sum of magnitudes
and one weighted by place, so that a swap is seen too."""
SAME = 1e-6
"""Relative difference of sums that counts as rounding."""


def make_lock(protocol: Protocol, *, worlds: bool = True) -> Lock:
    """``worlds``: compile the worlds of ``worlds_of`` and sum over each; about a second for each."""
    return Lock(
        id=protocol.name, protocol_sha256=protocol.sha256, fields=protocol.model_dump(mode="json"),
        embodiment=protocol.scene.robot.id,
        versions={name: version for name, version in package_versions().items() if name in PACKAGES},
        assets=asset_hashes(protocol),
        worlds={name: world_sums(*world) for name, world in (worlds_of(protocol) if worlds else {}).items()},
    )  # fmt: skip


def asset_hashes(protocol: Protocol) -> dict[str, str]:
    """Return the hashes of the protocol's bodies, their skin, the robot and the C sources of the tissue; files that are
    not there have no entry. The binary of the tissue has none, because it differs between platforms."""
    folder = resources.files("carecontact") / "assets"
    bodies = protocol.variation.bodies or (protocol.person.body,)
    places = [("bodies", f"{body}.{kind}") for body in bodies for kind in ("npz", "skin.png")]
    robot = protocol.scene.robot
    own = f"{robot.source.name}/{robot.source.name}.npz" if isinstance(robot.source, Baked) else robot.id
    return (
        {"kernel/c": sources_sha256()}
        | {
            f"{place}/{name}": hashlib.sha256(file.read_bytes()).hexdigest()
            for place, name in places
            if (file := folder / place / name).is_file()
        }
        | {own: robot.source.sha256}
    )


def worlds_of(protocol: Protocol) -> dict[str, tuple[Protocol, str]]:
    """Name -> protocol and target region of the worlds that a lock holds: every region once, and where bodies vary,
    every body with the regions in turn."""
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
    """Return the differences from the lock, one line each, most informative first; worlds only where ``now`` has
    them."""
    said: list[str] = []
    for what, before, after in (
        ("id", lock.id, now.id), ("embodiment", lock.embodiment, now.embodiment),
        ("protocol sha256", lock.protocol_sha256[:12], now.protocol_sha256[:12]),
    ):  # fmt: skip
        if before != after:
            said.append(f"{what}: locked {before}, here {after}")
    said += [
        f"{name}: locked {_short(before)}, here {_short(after)}"
        for name, before, after in _changed(lock.fields, now.fields)
    ]
    said += [
        f"version of {name}: locked {old or 'none'}, here {new or 'none'}"
        for name, old, new in _changed(lock.versions, now.versions)
    ]
    for name, *hashes in _changed(lock.assets, now.assets):
        old, new = (str(found or "none")[:12] for found in hashes)
        said.append(f"asset {name}: locked {old}, here {new}")
    for world, sums in now.worlds.items():
        held = lock.worlds.get(world, {})
        changed = [
            name for name in sorted(held.keys() | sums.keys())
            if not np.isclose(held.get(name, np.nan), sums.get(name, np.nan), rtol=SAME, atol=1e-12)
        ]  # fmt: skip
        if changed:
            told = ", ".join(changed[:4]) + (f" and {len(changed) - 4} more" if len(changed) > 4 else "")
            said.append(f"world ({world}): {told}")
    return said


def _changed(before: object, after: object, place: str = "") -> Iterator[tuple[str, object, object]]:
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for name in (*before, *(name for name in after if name not in before)):
            yield from _changed(before.get(name), after.get(name), f"{place}.{name}" if place else str(name))
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, (old, new) in enumerate(zip(before, after, strict=True)):
            yield from _changed(old, new, f"{place}[{number}]")
    elif before != after:
        yield place, before, after


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def lock_of(name_or_path: str, protocol: Protocol) -> Lock | None:
    """Return the lock that holds for a protocol: its own, or the shipped one where a file has the id of a shipped
    protocol."""
    return read_lock(protocol.id if is_borrowed(name_or_path, protocol) else name_or_path, level=protocol.level)


def is_borrowed(name_or_path: str, protocol: Protocol) -> bool:
    """Whether a file of the user's has the id of a shipped protocol: one id, one set of rules."""
    return protocol.id in shipped_protocols() and name_or_path != protocol.id


def check_frozen(name_or_path: str, protocol: Protocol, *, unfrozen: bool) -> Protocol:
    """Return the protocol, if it is a draft or equals its lock; quick, so the compiled worlds are left out.

    Args:
        unfrozen: go on where it differs; then the protocol's overrides, and so every output, name the differences.

    Raises ConfigError where a frozen protocol has no lock or differs from what ``lock_of`` gives.
    """
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
        named = f"{protocol.id}{SUFFIX}"
        others = [f"{name}=={held}" for name, held in lock.versions.items() if now.versions.get(name) != held]
        installing = f"Install the locked versions: python -m pip install {' '.join(others)}"
        own = installing if others else f"Take back what differs from {named}"
        remedy = f"Give {name_or_path} an id of its own" if borrowed else own
        raise ConfigError(
            f"protocol {protocol.id} differs from its lock ({'; '.join(differences)}), so its results would not be "
            f"comparable. {remedy}, or run with --unfrozen; then every output names the differences"
        )
    return protocol.model_copy(update={"overrides": {**protocol.overrides, "lock": "; ".join(differences)}})
