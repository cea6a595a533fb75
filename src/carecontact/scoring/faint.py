"""What a robot did that pressed the person too lightly, or too briefly, for any contact to count."""

from __future__ import annotations

import numpy as np

from carecontact.scoring.contact import Contact, any_column


def faint_press(contact: Contact) -> str | None:
    """Return words that continue "The robot": which segment it pressed, how long and how hard, and what it takes to
    count.

    None where nothing was pressed, and where the contact is valid. The force is the largest norm of a physics step; a
    contact begins where the normal force behind the low-pass filter of the contact definition reaches its ``on_n``.
    """
    felt = contact.force_norm > 0
    if contact.valid or not felt.any():
        return None
    definition = contact.protocol.contact
    pressed = any_column(felt, range(felt.shape[1]))
    step, segment = np.unravel_index(int(contact.force_norm.argmax()), felt.shape)
    name = contact.segments[int(segment)].replace("_", " ")
    what = (
        f"pressed the {name} for {_time(int(pressed.sum()) * contact.dt_s)} with "
        f"{_force(float(contact.force_norm[step, segment]))}"
    )
    if contact.reported is None:
        return f"{what}; contact counts from {definition.on_n:g} N"
    held = int(any_column(contact.on, contact.touched).sum()) * contact.dt_s
    return (
        f"{what}, of which {_time(held)} count as contact (from {definition.on_n:g} N); a trial needs "
        f"{_time(definition.valid_total_s)} of it"
    )


def _force(newton: float) -> str:
    return f"at most {newton:.1f} N" if newton >= 0.05 else "less than 0.05 N"


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 0.95 else f"{seconds:.2g} s"
