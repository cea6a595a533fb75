from __future__ import annotations

import pytest

from carecontact.audit.canary import other_arm_angle
from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import draw
from carecontact.protocols import load_protocol


@pytest.mark.parametrize("own_deg", [45.0, 60.0])
def test_the_other_arm_lies_far_from_where_the_arm_is_and_not_from_where_its_seed_drew_it_first(own_deg: float) -> None:
    """A person who does not suit the robot is drawn again, so that the angle is not the seed's first draw."""
    protocol = load_protocol()
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="hover")
    other = other_arm_angle(spec, own_deg=own_deg)
    angle = draw(protocol, region="forearm", seed=other.seed).comfort_arm_deg
    assert other.seed != spec.seed
    assert abs(angle - own_deg) > 9.0
