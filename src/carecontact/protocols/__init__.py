"""Protocol files, tissue sets and locks, and how a protocol is loaded and changed for a run."""

from carecontact.protocols.files import protocol_file, shipped_protocols
from carecontact.protocols.load import DEFAULT_PROTOCOL, load_levels, load_protocol
from carecontact.protocols.overrides import FAST_DT_S, overridden, without_overrides

__all__ = [
    "DEFAULT_PROTOCOL",
    "FAST_DT_S",
    "load_levels",
    "load_protocol",
    "overridden",
    "protocol_file",
    "shipped_protocols",
    "without_overrides",
]
