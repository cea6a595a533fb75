"""C4@1: share of the trial in which the tool moved."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


@metric(
    "C4@1", title="Motion activity", unit="1", better="higher", field="c4_motion_activity", digits=3, headline=True,
    matters=0.1, order=0,
)  # fmt: skip
def motion_activity(contact: Contact) -> float | None:
    """Share of physics steps from t = 0 with TCP speed or rotation above its threshold; None (NA) at zero length."""
    speed = contact.recording["scorer/tcp_speed"]
    rotation = contact.recording["scorer/tcp_rotation_speed"]
    if len(speed) == 0:
        return None
    definition = contact.protocol.contact
    active = (speed > definition.active_speed_m_s) | (rotation > definition.active_rotation_rad_s)
    return float(active.mean())
