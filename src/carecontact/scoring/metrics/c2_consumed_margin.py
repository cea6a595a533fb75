"""C2@2: the share of a joint's settled margin that a trial used up."""

from __future__ import annotations

from carecontact.scoring.contact import Contact
from carecontact.scoring.joints import consumed_margin
from carecontact.scoring.metrics.metric import metric


@metric("C2@2", title="Consumed joint margin", unit="1", better="lower", pool="moving", order=10)
def largest_consumed_margin(contact: Contact) -> float | None:
    """The largest share of any scored joint. C2@1 takes the joint that is nearest to its end, which in most trials is
    one that nobody moved; here each joint counts against where it was. None (NA) without valid contact."""
    if not contact.valid or contact.recording["scorer/human_joint_position"].size == 0:
        return None
    return float(consumed_margin(contact.recording).max())
