"""What parking knows of a person who has settled: the skin to be reached, the limb and the rest of the body."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Protocol
from carecontact.regions import REGIONS
from carecontact.sim.simulation import Simulation
from carecontact.world.human.skeleton import body_name
from carecontact.world.kept import Arrays
from carecontact.world.place import Place
from carecontact.world.scene import build_scene

Array = npt.NDArray[np.float64]

ALONG_M = 0.06
"""Distance [m] of both ends of a scrub from the middle of a region (``policies.state_machine.fixed_values``)."""
NEAR_M = 0.025
"""The height of the skin at a place is that of the highest vertex within this horizontal distance [m]."""
EVERY = 12
"""Every twelfth vertex stands for the body: about 1,000 vertices, some 30 mm apart."""
ARM = ("right_upper_arm", "right_forearm", "right_hand")
OUT_OF_THE_WAY_M = (0.0, 4.0, 0.55)
"""Place [m] of the robot's base while the person settles, far away from the bed."""


@dataclass(frozen=True, kw_only=True)
class Laid:
    """A person who has settled. All points are in the world [m]."""

    skin: Array
    """(R, 3, 3) highest skin over the axis of each region, at its middle and ALONG_M either way"""
    limb: Array
    """(4, 3) shoulder, elbow, wrist and finger tips of the right arm"""
    cloud: Array
    """(n, 3) vertices of the body"""
    on_arm: npt.NDArray[np.bool_]
    """(n,) whether each of these vertices belongs to the right arm"""
    pelvis: Array
    """(3,) middle of the pelvis"""

    def at(self, place: Place) -> Laid:
        """Return the same person at another place on the bed."""
        return replace(self, **{name: place.moved(getattr(self, name)) for name in ("skin", "limb", "cloud", "pelvis")})

    def repositioned(self, wrist_m: float, regions: tuple[str, ...]) -> Laid:
        """Return the person with the arm turned about the vertical axis through the shoulder.

        ``wrist_m``: how far [m] along the board this moves the wrist.
        """
        shoulder = self.limb[0]
        angle = wrist_m / float(np.hypot(*(self.limb[2] - shoulder)[:2]))
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        mine = np.array([REGIONS[name].segment in ARM for name in regions])

        def turned(points: Array) -> Array:
            return shoulder + (points - shoulder) @ turn.T

        return replace(
            self,
            skin=np.where(mine[:, None, None], turned(self.skin), self.skin),
            limb=turned(self.limb),
            cloud=np.where(self.on_arm[:, None], turned(self.cloud), self.cloud),
        )

    def arrays(self) -> Arrays:
        return {field.name: getattr(self, field.name) for field in fields(self)}


def lay_down(protocol: Protocol, comfort_arm_deg: float) -> Laid:
    """Let the person of a protocol settle in the protocol's own place with the robot far away; nothing is drawn.

    Raises SceneError or SettleError as a trial's world does.
    """
    away = protocol.scene.model_copy(update={"robot_base_m": OUT_OF_THE_WAY_M})
    simulation = Simulation(build_scene(protocol.model_copy(update={"scene": away}), target=None, skin=False))
    simulation.settle(comfort_arm_deg)
    data, body = simulation.data, simulation.scene.body
    limb = [data.body(body_name(segment)).xpos for segment in ARM]
    reach = data.body(body_name("right_hand")).xmat.reshape(3, 3) @ body.axis_vector("right_hand")
    owner = body.weight_segment[::EVERY, 0]
    segments = [body.segments[k] for k in owner]
    frames = [data.body(body_name(segment)) for segment in segments]
    offsets = body.vertices[::EVERY] - np.array([body.joint_centre[segment] for segment in segments])
    turns = np.array([frame.xmat.reshape(3, 3) for frame in frames])
    return Laid(
        skin=np.array([_skin(simulation, region) for region in protocol.regions]),
        limb=np.array([*limb, limb[2] + 2.0 * reach]),
        cloud=np.array([frame.xpos for frame in frames]) + np.einsum("nij,nj->ni", turns, offsets),
        on_arm=np.isin(segments, ARM),
        pelvis=data.body(body_name("pelvis")).xpos.copy(),
    )


def _skin(simulation: Simulation, region: str) -> Array:
    """Return three places (3, 3) [m] of the skin above a region's axis: its middle, and ALONG_M either way."""
    site = simulation.data.site(f"region_{region}")
    along = site.xmat.reshape(3, 3)[:, 0]
    places = site.xpos + np.array([-ALONG_M, 0.0, ALONG_M])[:, None] * along
    felt = simulation.tissue.get(region)
    if felt is None:
        out = simulation.scene.frames[region].size_m[2]
        return places + [0.0, 0.0, out]
    data = simulation.data
    points = data.xpos[felt.bone] + felt.vertices(data) @ data.xmat[felt.bone].reshape(3, 3).T
    for place in places:
        near = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < NEAR_M]
        if len(near):
            place[2] = near[:, 2].max()
    return places
