"""A region of the person on a held bone, without gravity, and a rigid tool over its middle that is free or driven.

Unlike the bench's indenter, the tool has a mass, may slide along the skin and may have any shape, and the compiled
tissue keeps its ledger of energy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.embodiment import EMBODIMENTS, Tip
from carecontact.kernel.readings import Readings
from carecontact.regions import REGIONS
from carecontact.validation.result import Array
from carecontact.validation.subject import Subject
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import body_name
from carecontact.world.human.tissue import add_tissue
from carecontact.world.scene import set_physics

HEAVY_KG = 1e6
"""A tool of this mass moves as prescribed, whatever force acts on it."""
WIDE_M = 0.03
"""Half the width of the skin that a tool covers; of a wider tool of the robot, its own."""
UPWARD = 0.3
"""Least cosine between the region's outward direction and the normals of skin on which a tool may be set."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A convex geom; x lies along the region, y across it, z points away from the skin."""

    name: str
    kind: mujoco.mjtGeom
    size_m: tuple[float, ...]
    height_m: float
    """Height of its centre over its lowest point."""
    give_m3_n: float = 0.0
    """Compliance of its surface [m/Pa]."""
    turned: tuple[float, ...] = field(default=(1.0, 0.0, 0.0, 0.0))
    """quat_wxyz"""


def of_tip(name: str, tip: Tip) -> Tool:
    return Tool(
        name=name, kind=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size_m=tip.half_m, height_m=tip.half_m[2],
        give_m3_n=tip.give_m3_n,
    )  # fmt: skip


CAP = of_tip("cap", EMBODIMENTS["caps"].tip)
PAD = Tool(name="pad", kind=mujoco.mjtGeom.mjGEOM_BOX, size_m=(0.015, 0.020, 0.006), height_m=0.006)
"""30 x 40 x 12 mm, with the rounded edges that the compiled tissue gives a box."""
FLANK = Tool(
    name="flank", kind=mujoco.mjtGeom.mjGEOM_CAPSULE, size_m=(0.030, 0.050, 0.0), height_m=0.030,
    turned=(float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0),
)  # fmt: skip
"""About the size of the side of the robot's hand, across the region."""


def robot_tool(subject: Subject) -> Tool:
    """Return the tool of the protocol's robot, which is the cap or the wash mitt."""
    name = subject.protocol.scene.tool
    return CAP if name == "caps" else of_tip(name, subject.protocol.scene.robot.tip)


class Rig:
    """One world with a tool on a region; ``reset`` puts it back to the beginning.

    Args:
        joints: "free", or "slides": first along the region, then away from the skin.
        mass_kg: mass of the tool [kg].
        at: where the tool's lowest point begins and how the tool lies there, as ``middle`` returns them; None: on the
            region's middle.
    """

    def __init__(
        self, subject: Subject, region: str, tool: Tool, *, joints: Literal["free", "slides"], mass_kg: float = 1.0,
        dt_s: float | None = None, at: tuple[Array, Array] | None = None,
    ) -> None:  # fmt: skip
        scene = subject.scene(region)
        self.shell = scene.regions[region].shell
        self._origin = scene.body.joint_centre[REGIONS[region].segment]
        spec = mujoco.MjSpec()
        set_physics(spec, dt_s=dt_s or subject.protocol.physics.dt_s)
        spec.option.gravity = [0, 0, 0]
        spec.worldbody.add_body(name=body_name(REGIONS[region].segment))
        add_tissue(spec, scene.body, region, self.shell, subject.tissue(region), tools="tool", ledger=True)
        self._add_tool(spec, tool, joints, mass_kg, *(at or middle(self.shell)))
        self.model = spec.compile()
        law = f"{region}/law"
        self.model.numeric(law).data[:] = scene.model.numeric(law).data
        self.data = mujoco.MjData(self.model)
        self.felt = Readings(self.model, region)
        self.reset()

    def _add_tool(
        self, spec: mujoco.MjSpec, tool: Tool, joints: str, mass_kg: float, point: Array, axes: Array
    ) -> None:  # fmt: skip
        self._skin = (self.shell.vertices - point) @ axes
        self._wide_m = max(WIDE_M, *tool.size_m[:2]) if tool.kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else WIDE_M
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        body = spec.worldbody.add_body(name="tool", pos=point - self._origin + tool.height_m * axes[:, 2], quat=quat)
        if joints == "free":
            body.add_freejoint()
        else:
            for axis in ([1, 0, 0], [0, 0, 1]):
                body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        geom = body.add_geom(
            type=tool.kind, size=[*tool.size_m, 0, 0][:3], quat=tool.turned, mass=mass_kg, contype=1, conaffinity=0
        )
        if tool.give_m3_n:
            spec.nuser_geom, geom.userdata = 1, [tool.give_m3_n]

    def reset(self, *, position: npt.ArrayLike = (), velocity: npt.ArrayLike = ()) -> None:
        """Put the tool, at rest or moving, on the first of its coordinates."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[: np.size(position)] = position
        self.data.qvel[: np.size(velocity)] = velocity
        mujoco.mj_forward(self.model, self.data)

    def clear_of_m(self, along_m: float) -> float:
        """Return how far [m] the tool must move away from the skin to touch none of it, at a place along the region."""
        under = (np.abs(self._skin[:, :2] - [along_m, 0.0]) < self._wide_m).all(1)
        return float(self._skin[under, 2].max())

    def kinetic_j(self) -> float:
        """Kinetic energy of the tool [J]."""
        momentum = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, momentum, self.data.qvel)
        return 0.5 * float(self.data.qvel @ momentum)


def middle(shell: Shell) -> tuple[Array, Array]:
    """Return the vertex (3,) nearest to the region's middle, and directions (3, 3) there as columns: along the region,
    across it and outward, in the mesh frame.
    """
    local = (shell.vertices - shell.frame_origin) @ shell.frame
    upward = np.flatnonzero(shell.normals @ shell.frame[:, 2] > UPWARD)
    at = upward[np.hypot(local[upward, 0], local[upward, 1]).argmin()]
    outward = shell.normals[at]
    along = shell.frame[:, 0] - (shell.frame[:, 0] @ outward) * outward
    along /= np.linalg.norm(along)
    return shell.vertices[at], np.stack([along, np.cross(outward, along), outward], 1)
