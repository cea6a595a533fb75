"""The indentation bench: one soft region on a held bone, pressed by a rigid indenter whose motion is prescribed.

The bone does not move and gravity is off, so that force against indentation is the tissue's alone. The indenter is a
very heavy body on one slide, put back on its path at every sample: unlike a mocap body it has a velocity, without which
contact damping would let the indenter sink in by about 20 ms times its speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError, SceneError
from carecontact.human.body import Array, Body
from carecontact.human.shell import Shell
from carecontact.human.skeleton import body_name
from carecontact.human.soft_region import add_tissue
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import EMBODIMENTS, Tip
from carecontact.protocol.person import Tissue
from carecontact.tissue.plugin import Readings, set_law
from carecontact.world.scene import region_shell, set_physics

Shape = Literal["flat", "hemisphere", "cap"]

LAW_FIELDS = ("a_n_m3", "b_n_m4", "c_n_m5", "damping_ns_m3", "damping_growth_ns_m4")
INDENTER_MASS_KG = 1e3
FLAT_LENGTH_M = 0.04
APPROACH_M = 0.0005
SEARCH_M = 0.02
"""The search for touch begins this far outside the surface."""


@dataclass(frozen=True, kw_only=True)
class Indenter:
    """An indenter, pressed along its axis: rigid, but for a ``cap``, the robot's tool, which lies across the region.

    Args:
        size_m: radius of the flat disc, whose rim ``tissue/c/tool.c`` rounds with 2 mm, or of the hemisphere; None for
            the cap, whose size is the tool's.
    """

    shape: Shape
    size_m: float | None = None
    tip: Tip = EMBODIMENTS["caps"].tip
    """Gives the cap its size and its compliance."""


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press, sampled from first geometric touch of the undeformed surface on; forces are on the indenter."""

    time_s: Array
    """(n,) 0 at geometric touch"""
    indentation_m: Array
    """(n,) travel of the indenter past geometric touch"""
    speed_m_s: Array
    """(n,) prescribed; positive inward"""
    force_n: Array
    """(n,) along the indenter's axis, positive when the tissue pushes it out"""
    anchor_m: Array
    """(n,) largest inward displacement of an anchor. The contact layer lets it stay behind the travel; it leads where a
    vertex stands above its triangles' middles, which carry the contact."""
    loading: npt.NDArray[np.bool_]
    """(n,) moving inward"""

    def at_depths(self, depths_m: Array, *, zero_n: float = 0.02) -> Array:
        """(k,) loading force at depths counted from where it first exceeds ``zero_n``, as a load cell finds touch.

        Raises SceneError where the press does not reach the deepest one.
        """
        depth, force = self.indentation_m[self.loading], self.force_n[self.loading]
        zero = touch_depth(depth, force, zero_n)
        if np.max(depths_m) > depth[-1] - zero + 1e-9:
            raise SceneError(
                f"the press ends {1000 * (depth[-1] - zero):.2f} mm past touch; "
                f"{1000 * np.max(depths_m):.2f} mm were requested"
            )
        return np.interp(depths_m, depth - zero, force)


def touch_depth(depth_m: Array, force_n: Array, threshold_n: float) -> float:
    """Depth at which a loading force first crosses the threshold, interpolated. Raises SceneError if it never does."""
    over = np.flatnonzero(force_n > threshold_n)
    if not len(over):
        raise SceneError(f"force never exceeds {threshold_n} N: the indenter does not touch the region here")
    k = int(over[0])
    if k == 0:
        return float(depth_m[0])
    share = (threshold_n - force_n[k - 1]) / (force_n[k] - force_n[k - 1])
    return float(depth_m[k - 1] + share * (depth_m[k] - depth_m[k - 1]))


class Bench:
    """A bench is compiled once and then makes any number of presses, at any place and speed, under any law on the same
    mesh.

    Args:
        region: a soft region.
        dt_s: time step [s].
        shell: of this body, region and tissue, if it is there already.
        glides: whether the indenter has a second slide, ``indenter_along``, on which it can be moved along the region.
    """

    def __init__(
        self,
        *,
        body: Body,
        region: str,
        tissue: Tissue,
        indenter: Indenter,
        dt_s: float = 0.002,
        shell: Shell | None = None,
        glides: bool = False,
    ) -> None:
        self.body, self.region, self.indenter = body, region, indenter
        self.shell = shell or region_shell(body, region, tissue)
        segment = REGIONS[region].segment
        self._bone_in_mesh = body.joint_centre[segment]
        spec = mujoco.MjSpec()
        set_physics(spec, dt_s=dt_s)
        spec.option.gravity = [0, 0, 0]
        spec.worldbody.add_body(name=body_name(segment))
        add_tissue(spec, body, region, self.shell, tissue, tools="indenter")
        _add_indenter(spec, indenter, glides=glides)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        slide = self.model.joint("indenter")
        self._slide_q, self._slide_v = int(slide.qposadr[0]), int(slide.dofadr[0])
        self.felt, self.tissue = Readings(self.model, region), tissue

    def set_law(self, tissue: Tissue) -> None:
        """Change stiffness and damping in the compiled model. Raises ConfigError where more than these would change."""
        for name in Tissue.model_fields:
            before, after = getattr(self.tissue, name), getattr(tissue, name)
            if name not in (*LAW_FIELDS, "source", "measured_depth_m", "calibration") and before != after:
                raise ConfigError(f"{name} {before} -> {after} changes more than the law: make a new Bench")
        set_law(self.model, self.region, tissue)
        self.tissue = tissue

    def place(self, along_m: float, across_m: float, tilt_deg: float = 0.0) -> tuple[Array, Array, Array]:
        """Surface point, inward press direction and the region's axis seen from there, in the bone's frame, (3,) each.

        The point lies under (along, across) of the region frame; the direction is the surface's inward normal, turned
        by ``tilt_deg`` toward the region's axis. Raises SceneError where there is no surface.
        """
        x, _, z = self.shell.frame.T
        local = (self.shell.vertices - self.shell.frame_origin) @ self.shell.frame
        corner = local[self.shell.triangles]
        e1, e2 = corner[:, 1, :2] - corner[:, 0, :2], corner[:, 2, :2] - corner[:, 0, :2]
        foot = np.array([along_m, across_m]) - corner[:, 0, :2]
        area = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (foot[:, 0] * e2[:, 1] - foot[:, 1] * e2[:, 0]) / area
            v = (e1[:, 0] * foot[:, 1] - e1[:, 1] * foot[:, 0]) / area
        weight = np.stack([1 - u - v, u, v], 1)
        upward = (self.shell.normals[self.shell.triangles] @ z).mean(1) > 0.1
        inside = np.flatnonzero(upward & (weight > -1e-9).all(1))
        if not len(inside):
            raise SceneError(
                f"no surface of the {self.region} lies under along {1000 * along_m:.1f} mm, "
                f"across {1000 * across_m:.1f} mm; the region's middle is 0, 0"
            )
        best = inside[(weight[inside] * corner[inside, :, 2]).sum(1).argmax()]
        nodes, share = self.shell.triangles[best], weight[best]
        point = share @ self.shell.vertices[nodes] - self._bone_in_mesh
        inward = -share @ self.shell.normals[nodes]
        inward /= np.linalg.norm(inward)
        axis = x - (x @ inward) * inward
        axis /= np.linalg.norm(axis)
        tilt = np.radians(tilt_deg)
        direction = np.cos(tilt) * inward + np.sin(tilt) * axis
        return point, direction, np.cos(tilt) * axis - np.sin(tilt) * inward

    def press(
        self,
        *,
        along_m: float = 0.0,
        across_m: float = 0.0,
        depth_m: float,
        speed_m_s: float = 0.005,
        tilt_deg: float = 0.0,
        unload: bool = False,
        hold_s: float = 0.0,
        acceleration_m_s2: float = 1.0,
        sample_s: float | None = None,
    ) -> Press:
        """Press ``depth_m`` past geometric touch at constant speed; slow down, hold and retreat if ``unload``.

        Args:
            acceleration_m_s2: at the turn, raised where it would take more than half the depth. Without ``unload`` and
                ``hold_s`` the press ends at full speed.
            sample_s: time between samples, rounded to steps; default: 150 samples on the way in, at least 200 per s.
        """
        sample_s = sample_s or min(0.005, depth_m / speed_m_s / 150)
        dt = self.model.opt.timestep
        approach = APPROACH_M + 5 * dt * speed_m_s
        turns = unload or hold_s > 0
        rate = max(acceleration_m_s2, speed_m_s**2 / depth_m)
        brake_m, brake_s = (speed_m_s**2 / 2 / rate, speed_m_s / rate) if turns else (0.0, 0.0)
        cruise = (approach + depth_m - brake_m) / speed_m_s
        stops = np.cumsum([cruise, brake_s, hold_s, *((brake_s, cruise) if unload else ())])
        time = np.arange(0.0, stops[-1] + dt / 2, dt)
        late = time - stops[0]
        path = np.where(late < 0, depth_m - brake_m + speed_m_s * late, depth_m)
        if turns:
            braking = (late >= 0) & (late < brake_s)
            path[braking] = depth_m - rate / 2 * (brake_s - late[braking]) ** 2
        if unload:
            back = time - stops[2]
            leaving = (back > 0) & (back <= brake_s)
            path[leaving] = depth_m - rate / 2 * back[leaving] ** 2
            gone = back > brake_s
            path[gone] = depth_m - brake_m - speed_m_s * (back[gone] - brake_s)
        stride = max(1, round(sample_s / dt))
        return self.follow(time, path, along_m=along_m, across_m=across_m, tilt_deg=tilt_deg, stride=stride)

    def follow(
        self,
        time_s: Array,
        depth_m: Array,
        *,
        along_m: float = 0.0,
        across_m: float = 0.0,
        tilt_deg: float = 0.0,
        stride: int = 1,
    ) -> Press:
        """Move along any path: depth past geometric touch over time, from out of contact on, every ``stride`` steps.

        The path is taken as straight between its points.
        """
        dt = self.model.opt.timestep
        touch, inward = self._touch(along_m, across_m, tilt_deg)
        count = int((time_s[-1] - time_s[0]) / (stride * dt) + 1e-9)
        time = time_s[0] + np.arange(count + 1) * stride * dt
        travel = touch + np.interp(time, time_s, depth_m)
        speed = np.r_[np.diff(travel) / (stride * dt), 0.0]
        model, data = self.model, self.data
        force, deepest = np.zeros(count + 1), np.zeros(count + 1)
        for k in range(count):
            data.qpos[self._slide_q], data.qvel[self._slide_v] = travel[k], speed[k]
            mujoco.mj_step(model, data, stride)
            # The row belongs to the pose in which the last step began, one step before sample k + 1.
            row = self.felt.last(data, 1)[0]
            force[k + 1] = row["force_n"] @ inward
            deepest[k + 1] = row["depth_m"]
        time = time - dt
        depth = np.interp(time, time_s, depth_m)
        first = int(np.argmax(depth >= 0))
        speed = np.r_[speed[0], speed[:-1]]
        return Press(
            time_s=(time - time[first] + depth[first] / max(speed[first], 1e-9))[first:],
            indentation_m=depth[first:],
            speed_m_s=speed[first:],
            force_n=force[first:],
            anchor_m=deepest[first:],
            loading=(speed > 0)[first:],
        )

    def response(
        self, depths_m: Array, *, along_m: float = 0.0, across_m: float = 0.0, speed_m_s: float = 0.005
    ) -> Array:
        """(k,) loading force at depths past the touch that a load cell would see; see Press.at_depths."""
        deepest_m = float(np.max(depths_m)) + 0.002
        press = self.press(along_m=along_m, across_m=across_m, depth_m=deepest_m, speed_m_s=speed_m_s)
        return press.at_depths(np.asarray(depths_m))

    def skin(self) -> tuple[Array, Array, Array]:
        """The surface at the end of the last press: (n, 2) where its vertices were before, across and along from the
        indenter's axis, and (n,) how far each has moved inward along that axis and along its own normal [m]. Of the
        side that is pressed."""
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, self.data.mocap_quat[0])
        along, across, outward = turn.reshape(3, 3).T
        from_tip = self.felt.places - self.data.mocap_pos[0]
        facing = -from_tip @ outward < self.tissue.thickness_m
        moved = self.felt.vertices(self.data) - self.felt.places
        places = from_tip @ np.stack([across, along], 1)
        return places[facing], -(moved @ outward)[facing], self.felt.displacement(self.data)[facing, 0]

    def _touch(self, along_m: float, across_m: float, tilt_deg: float) -> tuple[float, Array]:
        """Reset the bench, aim the indenter; the slide's travel at first touch, and the inward direction."""
        point, direction, axis = self.place(along_m, across_m, tilt_deg)
        frame = np.stack([axis, np.cross(-direction, axis), -direction], 1)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, frame.ravel())
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        data.mocap_pos[0], data.mocap_quat[0] = point, quat

        def touches(travel: float) -> bool:
            data.qpos[self._slide_q] = travel
            mujoco.mj_forward(model, data)
            return bool(self.felt.now(data)["points"] > 0)

        outside, inside = -SEARCH_M, 0.001
        if touches(outside) or not touches(inside):
            raise SceneError(f"the {self.region} has no free surface of {self.indenter.shape} size at this place")
        while inside - outside > 1e-6:
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if touches(middle) else (inside, middle)
        return inside, direction


def _add_indenter(spec: mujoco.MjSpec, indenter: Indenter, *, glides: bool) -> None:
    """A mocap carriage, whose pose aims the press, and on it a heavy body on one slide; its tip is at the origin."""
    carriage = spec.worldbody.add_body(name="carriage", mocap=True)
    probe = carriage.add_body(name="indenter", mass=INDENTER_MASS_KG, explicitinertial=True, inertia=[1.0, 1.0, 1.0])
    if glides:
        probe.add_joint(name="indenter_along", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    probe.add_joint(name="indenter", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, -1])
    kind, size, tip = mujoco.mjtGeom, indenter.size_m or 0.0, indenter.tip
    match indenter.shape:
        case "cap":
            form = {"type": kind.mjGEOM_ELLIPSOID, "size": tip.half_m, "pos": [0, 0, tip.half_m[2]]}
        case "hemisphere":
            form = {"type": kind.mjGEOM_SPHERE, "size": [size, 0, 0], "pos": [0, 0, size]}
        case "flat":
            half_m = FLAT_LENGTH_M / 2
            form = {"type": kind.mjGEOM_CYLINDER, "size": [size, half_m, 0], "pos": [0, 0, half_m]}
    geom = probe.add_geom(contype=1, conaffinity=0, condim=3, mass=0, **form)
    if indenter.shape == "cap" and tip.give_m3_n:
        spec.nuser_geom, geom.userdata = 1, [tip.give_m3_n]
