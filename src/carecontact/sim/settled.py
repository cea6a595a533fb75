"""Keeps settled persons between trials: they depend on the compiled model, the comfort angle, the place on the bed, the
settling rules, MuJoCo's version and the compiled tissue."""

from __future__ import annotations

import mujoco
import numpy as np

from carecontact.kernel.found import sha256 as kernel_sha256
from carecontact.sim.simulation import Settled, Simulation
from carecontact.world.kept import Arrays, kept
from carecontact.world.place import place_in_model


def settle(simulation: Simulation, comfort_arm_deg: float, *, model_sha256: str) -> Settled:
    """Settle the person, or load what ``simulation.settle`` gave before for the same model and angle. Raises
    SettleError as it does.

    Args:
        model_sha256: of the scene before anything was changed in it.
    """
    protocol = simulation.protocol
    facts = {
        "model": model_sha256, "mujoco": mujoco.__version__, "kernel": kernel_sha256(),
        "comfort_arm_deg": comfort_arm_deg.hex(),
        "phases": protocol.phases.model_dump(mode="json"), "target_period_s": protocol.physics.target_period_s,
        "parked": protocol.scene.parked_joint_rad, "place": [v.hex() for v in place_in_model(simulation.model)],
    }  # fmt: skip

    def compute() -> Arrays:
        settled = simulation.settle(comfort_arm_deg)
        return {
            "state": simulation.integration_state(), "joint_position": settled.joint_position,
            "wrist_in_world": settled.wrist_in_world, "duration_s": np.array(settled.duration_s),
            "comfort_arm_deg": np.array(settled.comfort_arm_deg),
        }  # fmt: skip

    found = kept("settled", facts, compute)
    simulation.restore(found["state"], comfort_arm_deg=comfort_arm_deg)
    return Settled(
        duration_s=float(found["duration_s"]), comfort_arm_deg=float(found["comfort_arm_deg"]),
        joint_position=found["joint_position"], wrist_in_world=found["wrist_in_world"],
    )  # fmt: skip
