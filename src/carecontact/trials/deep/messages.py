"""Shows the content of a sent or received message in words and as pictures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.contract.policy import PolicyCard
from carecontact.errors import ContractError
from carecontact.hosting.conversation import readable
from carecontact.hosting.dialects import vla_eval
from carecontact.hosting.dialects.again import dialect_of, unpacked
from carecontact.hosting.dialects.profiles import WRIST, profile_of
from carecontact.hosting.wire.packing import is_array, is_list, is_map

U8 = npt.NDArray[np.uint8]
F64 = npt.NDArray[np.float64]

SHOWN_CHARS = 80
DIALECTS = ("openpi", "roboarena", "vla-eval")


def leaves(value: object, *, prefix: str = "") -> dict[str, object]:
    """Return name -> value of every entry that is no map; keys of nested maps are joined with dots."""
    if not is_map(value):
        return {prefix: value}
    found: dict[str, object] = {}
    for key, inner in value.items():
        found |= leaves(inner, prefix=f"{prefix}.{key}" if prefix else str(key))
    return found


def decoded(frame: bytes | str, scheme: str) -> dict[str, object]:
    """Return the leaves of a frame; none if it cannot be decoded.

    Args:
        scheme: scheme of the policy's address; ``ws`` for a policy without an address.
    """
    if isinstance(frame, str):
        return {}
    try:
        return leaves(unpacked(frame, scheme if scheme in DIALECTS else ""))
    except ContractError:
        return {}


def chunk_of(frame: bytes | str, scheme: str) -> F64 | None:
    """Return the numbers (steps, columns) of a dialect's answer, unchanged; None if it has no such array."""
    found = decoded(frame, scheme)
    array = next((found[name] for name in ("actions", "payload.actions", "") if name in found), None)
    if not is_array(array) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or not array.size:
        return None
    with np.errstate(invalid="ignore"):
        return np.atleast_2d(array).astype(np.float64)


def pictures(sent: dict[str, object]) -> dict[str, U8]:
    """Return key -> picture (H, W, 3) for every picture among the leaves of a message."""
    return {
        key: value
        for key, value in sent.items()
        if is_array(value) and value.dtype == np.uint8 and value.ndim == 3 and value.shape[2] == 3
    }


def camera_names(card: PolicyCard) -> dict[str, str]:
    """Return key of a picture -> name of our camera."""
    dialect = dialect_of(card.arguments)
    if dialect == "vla-eval":
        return {f"payload.images.{vla_eval.EXTERIOR}": "exterior", f"payload.images.{vla_eval.WRIST}": "wrist"}
    if dialect:
        return {**{key: name for name, key in profile_of(card.arguments).exterior_keys.items()}, WRIST: "wrist"}
    return {f"observation.cameras.{name}.rgb": name for name in card.cameras}


def described(value: object) -> str:
    """Describe one leaf in a few words: kind, shape and range, or the text."""
    if is_array(value):
        if not value.size or value.dtype.kind not in "fiu":
            return f"{value.dtype.name} {value.shape}"
        known = value[np.isfinite(value)]
        span = f"{known.min():.4g} to {known.max():.4g}" if known.size else "no number"
        return f"{value.dtype.name} {value.shape}, {span}"
    if is_list(value):
        value = [int(v) if isinstance(v, bool | np.bool_) else v for v in value]
    return readable(repr(value)[:SHOWN_CHARS] + ("..." if len(repr(value)) > SHOWN_CHARS else ""))


def listed(found: dict[str, object]) -> list[str]:
    """Return one aligned line for each leaf."""
    names = {key: readable(key[:SHOWN_CHARS]) for key in found}
    width = max(map(len, names.values()), default=0)
    return [f"{names[key]:{width}}  {described(value)}" for key, value in found.items()]
