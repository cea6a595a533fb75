"""The largest torque with which an end stop held one of the person's joints."""

from __future__ import annotations

import numpy as np

from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.metric import metric


@metric("end_stop_torque@1", title="End-stop torque", unit="N m", better="lower", pool="moving")
def end_stop_torque(contact: Contact) -> float | None:
    """0 where no joint left its range. None (NA) without valid contact, and for recordings without
    ``scorer/human_joint_reaction``."""
    reaction = contact.recording.arrays.get("scorer/human_joint_reaction")
    if not contact.valid or reaction is None or reaction.size == 0:
        return None
    return float(np.abs(reaction.astype(np.float64)).max())
