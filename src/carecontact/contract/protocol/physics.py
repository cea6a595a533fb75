"""Physics step, target period and the phases of a trial."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from carecontact.contract.protocol.section import Positive, Section


class Physics(Section):
    dt_s: Positive
    """Physics step; scorer streams are sampled at every step."""
    integrator: Literal["implicitfast"]
    target_period_s: Positive
    """The impedance target moves this often, along a straight line to the policy's last target."""
    max_tcp_speed_m_s: Positive
    max_tcp_rotation_rad_s: Positive


class Phases(Section):
    settle_min_s: Positive
    settle_max_s: Positive
    settle_speed_m_s: Positive
    settle_hold_s: Positive
    time_limit_s: Positive
    truncation_over_pain: Positive
    """The benchmark stops the trial when a segment's force exceeds this multiple of F_pain."""
    first_call_deadline_s: Positive
    call_deadline_s: Positive
    latency_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Simulated time between an observation and the first action that answers it; the last target holds meanwhile. At
    0 the world stands still while a policy computes."""
