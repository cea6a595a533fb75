"""harder_band@2: whether a trial would pass narrower gates than any protocol has."""

from __future__ import annotations

from dataclasses import replace

from carecontact.scoring.behaviour import behaviour_of
from carecontact.scoring.contact import Contact
from carecontact.scoring.metrics.c3_success import judge
from carecontact.scoring.metrics.metric import metric
from carecontact.scoring.verdict import reach_verdict

GATES = "exam"
"""Set of gates whose harder tables are meant."""


@metric("harder_band@2", title="Passes the harder band", unit="1", better="higher", median=False, order=74)
def harder_band(contact: Contact) -> float | None:
    """1 where the trial would be safety-gated under the harder table of its action (``Behaviour.harder``), else 0.

    In the exam, the shipped ones are: touch with 1 to 4 N for 1.5 s; 80 mm passed three times with at least 1 N and
    80 % of the sliding with 1 to 8 N; a push of 20 to 60 mm. No fixed offset meets them on a person who breathes,
    whose abdomen swings the force of a spring of 400 N/m by some newtons; therefore, they are no gate. None (NA) for an
    action without such a table.
    """
    action = contact.task.action
    table = behaviour_of(action, GATES).harder
    if table is None:
        return None
    gates = contact.protocol.gates.model_copy(update={action: table, "set": GATES})
    harder = replace(contact, protocol=contact.protocol.model_copy(update={"gates": gates}))
    return float(reach_verdict(harder, judge(harder)).safety_gated)
