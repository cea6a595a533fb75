from __future__ import annotations

import pytest

from carecontact.audit.keyframe import Keyframe
from carecontact.contract.trial import TrialSpec
from carecontact.policies.motion import CONTROL_HZ
from carecontact.protocols import load_protocol


@pytest.mark.slow
def test_the_press_meets_soft_tissue_beside_a_large_chest() -> None:
    """A hand that lands on the chest first is stopped by bone, whose force tells nothing about tissue; seed 0 is a
    heavy woman."""
    protocol = load_protocol("bathing-wide-v2-draft", level="L3")
    spec = TrialSpec(protocol=protocol, task_id="T4", seed=0, policy="hover")
    keyframe = Keyframe(protocol, task_id="T4", seed=0)
    simulation, _, _ = keyframe.near(spec)
    steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
    for pose in keyframe.poses:
        simulation.set_goal(pose, 1 / CONTROL_HZ)
        simulation.advance(steps)
    assert simulation.tissue["upper_arm"].last(simulation.data, steps)["force_n"].any()
