"""What a server of the openpi family receives and what its answers mean: chosen by name, by option or by the server's
metadata."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

from carecontact.errors import ConfigError, PolicyError, did_you_mean
from carecontact.interface.deltas import DELTA_SPACE
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import CARTESIAN_IMPEDANCE
from carecontact.serving.cartesian import IMAGE, ORIENTATIONS, SETUPS, STATE, WRIST_IMAGE, delta_card
from carecontact.serving.packing import is_list

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
METADATA = "told"
"""Argument on the card of a server that described itself: its metadata as JSON."""


@dataclass(frozen=True, kw_only=True)
class Profile:
    name: str
    """Name of the profile, which the card and therefore every table shows."""
    action_space: str
    control: str
    """Name of the controller that follows the policy's targets."""
    image_hw: tuple[int, int] | None = (224, 224)
    """Height and width of every picture [px]; None sends pictures as they were captured, 288 by 512."""
    exterior_cameras: int = 1
    wrist: bool = True
    first_exterior: int = 1
    """Number of the first exterior camera in its key: 0 or 1."""
    horizon: int | None = 8
    """Number of actions of a chunk that are executed before the next query; None executes all."""
    endpoint: bool = False
    """Whether the server speaks as RoboArena's: requests name an endpoint and carry the Cartesian position, resets are
    sent, and pictures are stretched to their size; openpi pads them without distortion."""
    session: bool = False
    """Whether requests carry a random session id."""
    setup: str = ""
    """Name in SETUPS if the policy answers differences of the tool's pose; empty for one that answers joints."""
    orientation: str = "upright"
    """Name in ORIENTATIONS."""

    @property
    def exterior_keys(self) -> dict[str, str]:
        """Name of our camera -> key of its picture."""
        if self.setup:
            return {"exterior": IMAGE}
        cameras = EXTERIOR_CAMERAS[: self.exterior_cameras]
        return {camera: EXTERIOR.format(self.first_exterior + i) for i, camera in enumerate(cameras)}

    @property
    def picture_keys(self) -> dict[str, str]:
        """The same, with the wrist camera if it is sent."""
        return self.exterior_keys | ({"wrist": WRIST_IMAGE if self.setup else WRIST} if self.wrist else {})

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key of a request, without those inside arrays."""
        roboarena = (ENDPOINT, CARTESIAN) if self.endpoint else ()
        session = (SESSION,) if self.session else ()
        state = (STATE,) if self.setup else (JOINTS, GRIPPER)
        return (*self.picture_keys.values(), *state, PROMPT, *roboarena, *session)

    def metadata(self) -> dict[str, object]:
        """Return this profile as a server announces it, in the fields of RoboArena's PolicyServerConfig; deltas have no
        name there."""
        theirs = next((theirs for theirs, ours in SPACES.items() if ours == self.action_space), self.action_space)
        return {
            "image_resolution": None if self.image_hw is None else list(self.image_hw),
            "needs_wrist_camera": self.wrist,
            "n_external_cameras": self.exterior_cameras,
            "needs_stereo_camera": False,
            "needs_session_id": self.session,
            "action_space": theirs,
        }


PROFILES = {
    "pi05-droid": Profile(name="pi05-droid", action_space="droid_joint_velocity", control="droid"),
    "pi05-droid-jointpos": Profile(
        name="pi05-droid-jointpos", action_space="joint_position", control="droid-sim-evals"
    ),
    **{
        name: Profile(
            name=name,
            setup=name,
            action_space=DELTA_SPACE,
            control=CARTESIAN_IMPEDANCE,
            wrist=setup.wrist,
            horizon=setup.horizon,
            orientation=setup.orientation,
        )
        for name, setup in SETUPS.items()
    },
}
"""``pi05-droid`` follows openpi's examples/droid/main.py, ``pi05-droid-jointpos`` the client of PolaRiS. Both send the
keys of openpi's policies/droid_policy.py. A server's metadata do not say which of the two it expects. The others are
those of SETUPS."""


def named_profile(options: Mapping[str, str]) -> Profile:
    """Return the profile that an address names, with its other options. Raises ConfigError for an unknown name."""
    name = _known("profile", options["profile"], PROFILES)
    profile = PROFILES[name]
    horizon = int(options.get("horizon", str(profile.horizon)))
    if not profile.setup:
        if "orientation" in options:
            raise ConfigError(f"orientation: the profile {name} has upright pictures; only {', '.join(SETUPS)} take it")
        return replace(profile, horizon=horizon, first_exterior=int(options.get("exterior", "1")))
    if "exterior" in options:
        raise ConfigError(f"exterior: the pictures of the profile {name} have no number; leave it out")
    return replace(profile, horizon=horizon, orientation=_orientation(options, profile.orientation))


def _known(kind: str, name: str, valid: Collection[str]) -> str:
    """Return the name. Raises ConfigError for one that is not among those that are ``valid``."""
    if name not in valid:
        raise ConfigError(f"no {kind} named {name!r}{did_you_mean(name, valid)}; valid: {', '.join(valid)}")
    return name


def announced_profile(metadata: Mapping[str, object], options: Mapping[str, str]) -> Profile:
    """Return the profile that a server's metadata describe in RoboArena's terms. Raises PolicyError ``handshake``."""
    if "action_space" not in metadata:
        raise _refused(
            f"expected the field action_space ({', '.join(SPACES)}), got {sorted(metadata)!s:.200}; the address of an "
            f"openpi server is openpi://HOST:PORT?profile=NAME, one of {', '.join(PROFILES)}"
        )
    space, external = metadata["action_space"], metadata.get("n_external_cameras", 1)
    if not isinstance(space, str) or space not in SPACES:
        raise _refused(
            f"action_space: expected {' or '.join(SPACES)}, got {space!r:.80}; no other one is executed here"
        )
    if type(external) is not int or not 0 <= external <= len(EXTERIOR_CAMERAS):
        cameras = f"{len(EXTERIOR_CAMERAS)} ({', '.join(EXTERIOR_CAMERAS)})"
        raise _refused(f"n_external_cameras: expected 0 to {cameras}, got {external!r:.80}")
    flags = {"needs_wrist_camera": True, "needs_stereo_camera": False, "needs_session_id": False}
    for name in flags:
        flag = metadata.get(name, flags[name])
        if not isinstance(flag, bool):
            raise _refused(f"{name}: expected true or false, got {flag!r:.80}")
        flags[name] = flag
    if flags["needs_stereo_camera"]:
        raise _refused(
            "needs_stereo_camera: no camera of this benchmark has two pictures; serve with needs_stereo_camera=False"
        )
    hw = metadata.get("image_resolution", [224, 224])
    sizes = [v for v in hw if type(v) is int and 16 <= v <= 2048] if is_list(hw) else []
    if hw is not None and not (is_list(hw) and len(hw) == len(sizes) == 2):
        raise _refused(f"image_resolution: expected [height, width] of 16 to 2048 pixels or none, got {hw!r:.80}")
    return Profile(
        name="roboarena",
        action_space=SPACES[space],
        control="droid",
        horizon=None,
        endpoint=True,
        image_hw=None if hw is None else (sizes[0], sizes[1]),
        exterior_cameras=external,
        wrist=flags["needs_wrist_camera"],
        session=flags["needs_session_id"],
        first_exterior=int(options.get("exterior", "1")),
    )


def _refused(why: str) -> PolicyError:
    return PolicyError("handshake", f"the server's metadata: {why}")


def contradiction(profile: Profile, metadata: Mapping[str, object]) -> str:
    """Return the first field in which metadata contradict the named profile; empty if none does."""
    for name, value in profile.metadata().items():
        if name != "needs_session_id" and name in metadata and metadata[name] != value:
            return f"{name} is {metadata[name]!r:.80} in the server's metadata and {value!r} in the profile"
    return ""


def fitting(metadata: Mapping[str, object]) -> str:
    """Return which addresses the metadata of a server do not contradict, in words."""
    fits = [f"?profile={name}" for name, profile in PROFILES.items() if not contradiction(profile, metadata)]
    with suppress(PolicyError):
        announced_profile(metadata, {})
        fits.append("no profile")
    return f"the address that fits has {' or '.join(fits)}" if fits else "no profile fits"


def card_of(profile: Profile) -> PolicyCard:
    """Make the card of a server that sends none. Its arguments hold all that decides what is sent (``profile_of``)."""
    if profile.setup:
        arguments = {"dialect": "openpi", "profile": profile.name, "horizon": str(profile.horizon)}
        arguments["orientation"] = profile.orientation
        return delta_card(f"openpi {profile.name}", SETUPS[profile.setup], tuple(profile.picture_keys), arguments)
    arguments = {"dialect": "openpi", "exterior": str(profile.first_exterior)}
    if profile.endpoint:
        arguments |= {"dialect": "roboarena", METADATA: json.dumps(profile.metadata())}
    else:
        arguments |= {"profile": profile.name, "horizon": str(profile.horizon)}
    name = profile.name if profile.endpoint else f"openpi {profile.name}"
    return joint_card(name, profile.action_space, tuple(profile.picture_keys), arguments, control=profile.control)


def joint_card(
    name: str, action_space: str, cameras: tuple[str, ...], arguments: Mapping[str, str], *, control: str = "droid"
) -> PolicyCard:
    """Make the card of a server whose actions are joint positions or velocities, and which is shown pictures alone."""
    return PolicyCard(
        name=name,
        action_space=action_space,
        control=control,
        modalities=("rgb",) if cameras else (),
        cameras=cameras or ("exterior",),
        control_hz=RATE_HZ,
        # The simulations of these clients accept a target beyond a joint's limit, and the limit stops the joint.
        out_of_bounds="clip" if action_space == "joint_position" else "error",
        arguments=arguments,
    )


def profile_of(given: Mapping[str, str]) -> Profile:
    """Return the profile of a card that ``card_of`` made, so that an audit can make its messages again."""
    if METADATA in given:
        return announced_profile(cast(dict[str, object], json.loads(given[METADATA])), given)
    return named_profile(given)


def check_options(ref: PolicyRef) -> None:
    """Check the options in a server's address before anything is connected. Raises ConfigError for an unknown profile
    or action space; the message lists the known ones.
    """
    options, spaces = dict(ref.options), tuple(SPACES.values())
    try:
        if "space" in options and options["space"] not in spaces:
            meant = did_you_mean(options["space"], spaces)
            raise ConfigError(
                f"no action space {options['space']!r} in this dialect{meant}; valid: {', '.join(spaces)}"
            )
        if ref.scheme == "vla-eval":
            vla_eval_setup(options)
        elif "profile" in options:
            named_profile(options)
        elif "orientation" in options:
            raise ConfigError(f"orientation: only the profiles {', '.join(SETUPS)} take it")
    except ConfigError as error:
        raise ConfigError(f"policy {ref}: {error}") from None


def vla_eval_setup(options: Mapping[str, str]) -> tuple[str, str] | None:
    """Return the profile and the orientation that the address of a vla-eval server names; None without a profile.
    Raises ConfigError for an unknown profile, and for options that exclude each other."""
    if "profile" not in options:
        if "orientation" in options:
            raise ConfigError(f"orientation: only the profiles {', '.join(SETUPS)} take it")
        return None
    name = _known("profile", options["profile"], SETUPS)
    if "space" in options:
        raise ConfigError(f"space: the profile {name} says that the actions are {DELTA_SPACE}; leave space out")
    return name, _orientation(options, SETUPS[name].orientation)


def _orientation(options: Mapping[str, str], default: str) -> str:
    return _known("orientation", options.get("orientation", default), ORIENTATIONS)
