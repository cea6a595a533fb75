"""Worlds from which the audit's trials begin: settled once, with the robot parked or about to touch."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.episode.drawn import draw, like
from carecontact.episode.prepare import settled_world
from carecontact.errors import SceneError
from carecontact.kernel.region import set_law
from carecontact.policies.motion import UP, Leg, radial_quat, sample, travel
from carecontact.sim.simulation import Samples, Settled, Simulation
from carecontact.validation.moves import skin_points

F64 = npt.NDArray[np.float64]

CONTROL_HZ = 20.0
"""Rate of the pressing motion."""
PRESS_DEPTH_M = 0.020
"""Commanded depth [m] below the skin; at the default 400 N/m it limits the force to 8 N."""
CLEARANCE_M = 0.20
"""Height [m] over the skin on the way to the press."""
PRESS_SPEED_M_S = 0.06
BEFORE_S, AFTER_S = 0.30, 0.45
"""How long [s] before the first contact the later keyframe lies, and how much [s] of the press follows that contact."""
ATTEMPTS = 5
NEAR_MIDDLE_M = 0.02
STIFFER = 2.0
"""Factor by which the twin's tissue is stiffer."""


class Keyframe:
    """One settled world of a task and seed. All trials that begin from it begin from the same bits."""

    def __init__(self, protocol: Protocol, *, task_id: str, seed: int, salt: str = "") -> None:
        """Build the world, let the person settle, and press once.

        Raises SceneError or SettleError as a trial does, and SceneError if the robot cannot touch the region.
        """
        simulation, self.settled, self.model_sha256 = settled_world(protocol, task_id=task_id, seed=seed, salt=salt)
        region = protocol.task(task_id).region
        self.laid_at_deg = draw(protocol, region=region, seed=seed, salt=salt).comfort_arm_deg
        """Angle [deg] at which the person's arm was laid."""
        self.scene = simulation.scene
        self._parked = simulation.integration_state()
        self.parked_pose = simulation.control.target_in_base
        """(7,) pose of the tool centre point in the robot's base; a robot that is given it as target stays where it
        is."""
        self._near, self.poses = self._approach(simulation, region=region)
        """(n, 7) poses of the tool centre point in the robot's base at CONTROL_HZ: they begin at the later keyframe and
        end in contact."""

    def parked(self, spec: TrialSpec) -> tuple[Simulation, Settled, str]:
        """Return the world with the robot parked; give this method to ``run_trial`` as ``prepare``."""
        return self._begin(Simulation(self.scene), self._parked)

    def near(self, spec: TrialSpec) -> tuple[Simulation, Settled, str]:
        """Return the world with the tool BEFORE_S before its first contact; also for ``prepare``."""
        return self._begin(Simulation(self.scene), self._near)

    def twin(self, spec: TrialSpec) -> tuple[Simulation, Settled, str]:
        """Return the same moment in a world with the hidden values of ``spec`` and stiffer tissue.

        It moves like the other world until contact, because tissue that nothing touches has no effect.
        """
        scene = replace(
            self.scene, model=copy.deepcopy(self.scene.model), protocol=like(spec.protocol, self.scene.protocol)
        )
        for name, region in scene.regions.items():
            law = region.tissue.model_dump()
            stiffer = {field: STIFFER * law[field] for field in ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3")}
            set_law(scene.model, name, region.tissue.model_copy(update=stiffer))
        return self._begin(Simulation(scene), self._near)

    def _begin(self, simulation: Simulation, state: F64) -> tuple[Simulation, Settled, str]:
        simulation.restore(state, comfort_arm_deg=self.laid_at_deg)
        return simulation, self.settled, self.model_sha256

    def _approach(self, simulation: Simulation, *, region: str) -> tuple[F64, F64]:
        """Return the state BEFORE_S before first contact and the poses (n, 7) that follow it. If the person has moved
        meanwhile, the press is aimed again.
        """
        simulation.start()
        steps = round(1 / CONTROL_HZ / simulation.model.opt.timestep)
        back, ahead = round(BEFORE_S * CONTROL_HZ), round(AFTER_S * CONTROL_HZ)
        states, done = [simulation.integration_state()], list[F64]()
        for _ in range(ATTEMPTS):
            poses = _press(simulation, region)
            for k, pose in enumerate(poses):
                simulation.set_goal(pose, 1 / CONTROL_HZ)
                if touches(simulation.advance(steps)):
                    at = len(done) + k
                    first = max(at - back, 0)
                    # A robot that came late may touch near the end of its way, and then stays there.
                    stays = np.repeat(poses[-1:], ahead, 0)
                    return states[-1 - (at - first)], np.array([*done, *poses, *stays])[first : at + 1 + ahead]
                states = [*states[-back:], simulation.integration_state()]
            done += list(poses)
        raise SceneError(f"the audit's press does not touch the {region} in {ATTEMPTS} attempts")


def _press(simulation: Simulation, region: str) -> F64:
    """Return poses (n, 7) of the tool centre point in the robot's base at CONTROL_HZ, from where the robot is to a
    press on the region where it lies now.
    """
    simulation.refresh()
    base = simulation.encoders.in_base(simulation.data, _skin_in_world(simulation, region), np.eye(3))
    skin, start = base[:3, 3], simulation.control.target_in_base
    press = Leg(points=(skin - PRESS_DEPTH_M * UP)[None], quat_wxyz=radial_quat(skin), speed_m_s=PRESS_SPEED_M_S)
    above = replace(press, points=(skin + 0.02 * UP)[None], speed_m_s=5 * PRESS_SPEED_M_S)
    hold = replace(press, hold_s=AFTER_S)
    legs = travel(start, [above, hold], travel_height_m=float(skin[2]) + CLEARANCE_M)[:-1]
    return np.array(list(sample(legs, start, control_hz=CONTROL_HZ)))


def touches(samples: list[Samples]) -> bool:
    return any(bool(s.force.any()) for s in samples)


def _skin_in_world(simulation: Simulation, region: str) -> F64:
    """Return the highest place (3,) [m] of the shell near the region's middle, where the hand does not touch a large
    chest.
    """
    vertices = skin_points(simulation, region)
    middle = simulation.data.site(f"region_{region}").xpos
    near = np.linalg.norm(vertices[:, :2] - middle[:2], axis=1) < NEAR_MIDDLE_M
    return np.array([*middle[:2], vertices[near, 2].max()])
