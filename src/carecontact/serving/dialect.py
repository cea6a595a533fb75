"""What a server of another project's family receives and what its answers mean: chosen by name, by option or by the
server's metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NoReturn, cast

from carecontact.errors import ConfigError, PolicyError, did_you_mean
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.serving.packing import is_list

# What a server of the openpi family receives and what its answers mean: chosen by name or by the server's metadata.

EXTERIOR = "observation/exterior_image_{}_left"
"""Key of an exterior camera's picture. "Left" means the left picture of a stereo camera."""
WRIST, JOINTS = "observation/wrist_image_left", "observation/joint_position"
GRIPPER, CARTESIAN = "observation/gripper_position", "observation/cartesian_position"
PROMPT, ENDPOINT, SESSION = "prompt", "endpoint", "session_id"

EXTERIOR_CAMERAS = ("exterior", "bedside")
"""Our exterior cameras, in the order in which they serve a server that asks for one or two."""
RATE_HZ = 15.0
"""Control rate [Hz] of DROID's data and of its clients."""
SPACES = {"joint_velocity": "droid_joint_velocity", "joint_position": "joint_position"}
"""RoboArena's name of an action space -> our name. The dialects execute no other action space."""
FIELDS = (
    "image_resolution", "needs_wrist_camera", "n_external_cameras", "needs_stereo_camera", "needs_session_id",
    "action_space",
)  # fmt: skip
"""Fields of RoboArena's PolicyServerConfig, which a server sends as its metadata."""


@dataclass(frozen=True, kw_only=True)
class Profile:
    name: str
    """Name of the profile, which the card and therefore every table shows."""
    action_space: str
    control: str
    """Name of the controller that follows the policy's targets."""
    resize: Literal["pad", "stretch"] = "pad"
    """``pad``: resize without distortion, as openpi does; ``stretch``: as RoboArena does."""
    image_hw: tuple[int, int] | None = (224, 224)
    """Height and width of every picture [px]; None sends pictures as they were captured, 288 by 512."""
    exterior_cameras: int = 1
    wrist: bool = True
    first_exterior: int = 1
    """Number of the first exterior camera in its key: 0 or 1."""
    horizon: int | None = 8
    """Number of actions of a chunk that are executed before the next query; None executes all."""
    endpoint: bool = False
    """Whether requests name an endpoint and carry the Cartesian position, and resets are sent, as for RoboArena."""
    session: bool = False
    """Whether requests carry a random session id."""
    rate_hz: float = RATE_HZ
    closed_gripper: float = 1.0
    """The value by which the server denotes a closed gripper. Ours is 0."""

    @property
    def exterior_keys(self) -> dict[str, str]:
        """Name of our camera -> key of its picture."""
        cameras = EXTERIOR_CAMERAS[: self.exterior_cameras]
        return {camera: EXTERIOR.format(self.first_exterior + i) for i, camera in enumerate(cameras)}

    @property
    def cameras(self) -> tuple[str, ...]:
        return (*self.exterior_keys, *(("wrist",) if self.wrist else ()))

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key of a request, without those inside arrays."""
        roboarena = (ENDPOINT, CARTESIAN) if self.endpoint else ()
        session = (SESSION,) if self.session else ()
        wrist = (WRIST,) if self.wrist else ()
        return (*self.exterior_keys.values(), *wrist, JOINTS, GRIPPER, PROMPT, *roboarena, *session)


PROFILES = {
    "pi05-droid": Profile(name="pi05-droid", action_space="droid_joint_velocity", control="droid"),
    "pi05-droid-jointpos": Profile(
        name="pi05-droid-jointpos", action_space="joint_position", control="droid-sim-evals"
    ),
}
"""``pi05-droid`` follows openpi's examples/droid/main.py, ``pi05-droid-jointpos`` the client of PolaRiS. Both send the
keys of openpi's policies/droid_policy.py. A server's metadata do not say which of the two it expects."""


def named_profile(options: Mapping[str, str]) -> Profile:
    """Return the profile that an address names, with its other options applied. Raises ConfigError for an unknown
    name.
    """
    name = options["profile"]
    if name not in PROFILES:
        raise ConfigError(f"no profile named {name!r}{did_you_mean(name, PROFILES)}; valid: {', '.join(PROFILES)}")
    profile = PROFILES[name]
    return replace(
        profile,
        horizon=int(options.get("horizon", str(profile.horizon))),
        first_exterior=int(options.get("exterior", "1")),
    )


def announced_profile(metadata: Mapping[str, object], options: Mapping[str, str]) -> Profile:
    """Return the profile that a server's metadata describe in RoboArena's terms.

    Raises PolicyError ``handshake`` for a field that is missing, is not what RoboArena defines, or asks for what this
    benchmark does not have.
    """
    told = {name: metadata[name] for name in FIELDS if name in metadata}
    if "action_space" not in told:
        _refuse(f"expected the field action_space ({', '.join(SPACES)}), got {sorted(metadata)!s:.200}", ask=True)
    space = told["action_space"]
    if not isinstance(space, str) or space not in SPACES:
        _refuse(f"action_space: expected {' or '.join(SPACES)}, got {space!r:.80}; no other one is executed here")
    external = told.get("n_external_cameras", 1)
    if type(external) is not int or not 0 <= external <= len(EXTERIOR_CAMERAS):
        cameras = f"{len(EXTERIOR_CAMERAS)} ({', '.join(EXTERIOR_CAMERAS)})"
        _refuse(f"n_external_cameras: expected 0 to {cameras}, got {external!r:.80}")
    flags = {
        name: told.get(name, default)
        for name, default in (("needs_wrist_camera", True), ("needs_stereo_camera", False), ("needs_session_id", False))
    }
    for name, flag in flags.items():
        if type(flag) is not bool:
            _refuse(f"{name}: expected true or false, got {flag!r:.80}")
    if flags["needs_stereo_camera"]:
        _refuse(
            "needs_stereo_camera: no camera of this benchmark has two pictures; serve with needs_stereo_camera=False"
        )
    return Profile(
        name="roboarena", action_space=SPACES[space], control="droid", resize="stretch", horizon=None, endpoint=True,
        image_hw=_resolution(told.get("image_resolution", [224, 224])), exterior_cameras=external,
        wrist=bool(flags["needs_wrist_camera"]), session=bool(flags["needs_session_id"]),
        first_exterior=int(options.get("exterior", "1")),
    )  # fmt: skip


def describes_itself(metadata: Mapping[str, object]) -> bool:
    """Whether metadata have RoboArena's fields, which openpi's own servers do not send."""
    return "action_space" in metadata


def contradiction(profile: Profile, metadata: Mapping[str, object]) -> str:
    """Return the first field in which metadata contradict the named profile; empty if none does."""
    known: dict[str, object] = {
        "action_space": {ours: theirs for theirs, ours in SPACES.items()}[profile.action_space],
        "image_resolution": list(profile.image_hw or ()),
        "needs_wrist_camera": profile.wrist,
        "n_external_cameras": profile.exterior_cameras,
        "needs_stereo_camera": False,
    }
    for name, value in known.items():
        if name in metadata and metadata[name] != value:
            return f"{name} is {metadata[name]!r:.80} in the server's metadata and {value!r} in the profile"
    return ""


def fitting(metadata: Mapping[str, object]) -> str:
    """Return which addresses the metadata of a server do not contradict, in words."""
    fits = [f"?profile={name}" for name, profile in PROFILES.items() if not contradiction(profile, metadata)]
    with suppress(PolicyError):
        announced_profile(metadata, {})
        fits.append("no profile")
    return f"the address that fits has {' or '.join(fits)}" if fits else "no profile fits"


def card_of(profile: Profile, *, dialect: str) -> PolicyCard:
    """Make the card of a server that sends none. Its arguments hold all that decides what is sent (``profile_of``)."""
    return PolicyCard(
        name=f"{dialect} {profile.name}" if dialect != profile.name else dialect,
        action_space=profile.action_space,
        control=profile.control,
        modalities=("rgb",) if profile.cameras else (),
        cameras=profile.cameras or ("exterior",),
        control_hz=profile.rate_hz,
        # The simulations of these clients accept a target beyond a joint's limit, and the limit stops the joint.
        out_of_bounds="clip" if profile.action_space == "joint_position" else "error",
        arguments=_arguments(profile, dialect),
    )


def profile_of(given: Mapping[str, str]) -> Profile:
    """Return the profile of a card that ``card_of`` made, from its arguments, so that an audit can make its messages
    again.
    """
    if "told" in given:
        return announced_profile(cast(dict[str, object], json.loads(given["told"])), given)
    return named_profile(given)


def _arguments(profile: Profile, dialect: str) -> dict[str, str]:
    common = {"dialect": dialect, "exterior": str(profile.first_exterior)}
    if not profile.endpoint:
        return {**common, "profile": profile.name, "horizon": str(profile.horizon)}
    space = {ours: theirs for theirs, ours in SPACES.items()}[profile.action_space]
    hw = None if profile.image_hw is None else list(profile.image_hw)
    told = dict(zip(FIELDS, (hw, profile.wrist, profile.exterior_cameras, False, profile.session, space), strict=True))
    return {**common, "told": json.dumps(told)}


def _resolution(value: object) -> tuple[int, int] | None:
    if value is None:
        return None
    if not is_list(value) or len(value) != 2 or not all(type(v) is int and 16 <= v <= 2048 for v in value):
        _refuse(f"image_resolution: expected [height, width] of 16 to 2048 pixels or none, got {value!r:.80}")
    height, width = cast(list[int], value)
    return height, width


def _refuse(why: str, *, ask: bool = False) -> NoReturn:
    names = ", ".join(PROFILES)
    remedy = f"; the address of an openpi server is openpi://HOST:PORT?profile=NAME, one of {names}" if ask else ""
    raise PolicyError("handshake", f"the server's metadata: {why}{remedy}")


# Checks the options in the address of a dialect's server before anything is connected.


def check_options(ref: PolicyRef) -> None:
    """Check the options. Raises ConfigError for an unknown profile or action space; the message lists the known
    ones.
    """
    options = dict(ref.options)
    if "profile" in options:
        try:
            named_profile(options)
        except ConfigError as error:
            raise ConfigError(f"policy {ref}: {error}") from None
    spaces = tuple(SPACES.values())
    if "space" in options and options["space"] not in spaces:
        meant = did_you_mean(options["space"], spaces)
        raise ConfigError(
            f"policy {ref}: no action space {options['space']!r} in this dialect{meant}; valid: {', '.join(spaces)}"
        )
