"""What the elbow's neutral angle changes, and a figure of the joints' torques.

    python tools/joint_rest.py [BODY ...]          a table: each body at rest, with and without the neutral angle
    python tools/joint_rest.py --figure FILE.png   torque over angle beside the published curves

"laid" is the same person with elbows that rest where they were laid, as they did before they had a neutral angle.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from carecontact.human.joints import ELBOW_NEUTRAL_DEG, ELBOW_RANGE_NM_RAD, Hinge, hinges
from carecontact.human.library import body_names, load_body
from carecontact.human.skeleton import REACHED_RAD, cubic_nm_rad3, end_stop_nm, past_range
from carecontact.plotting import draw_figure
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import Scene, build_scene

COMFORT_ARM_DEG, DRIFT_S = 52.5, 10.0
ELBOW, NEUTRAL_SPREAD_DEG = "right_forearm_flexion", 10.0


def resting_where_laid(scene: Scene) -> Scene:
    return replace(scene, hinges=tuple(replace(hinge, neutral_deg=None) for hinge in scene.hinges))


def board_load_n(simulation: Simulation) -> float:
    """What forearm and hand weigh on the arm board, averaged over a tenth of a second [N]."""
    model, data, wrench = simulation.model, simulation.data, np.zeros(6)
    limbs = {model.body(f"human_right_{part}").id for part in ("forearm", "hand")}
    board, total, steps = model.geom("bed_armboard").id, 0.0, 50
    for _ in range(steps):
        simulation.advance(1)
        for number, contact in enumerate(data.contact[: data.ncon]):
            geoms = contact.geom.tolist()
            if board in geoms and limbs & set(model.geom_bodyid[geoms].tolist()):
                mujoco.mj_contactForce(model, data, number, wrench)
                total += abs(float(contact.frame[2] * wrench[0]))
    return total / steps


def row(body: str, scene: Scene, name: str) -> str:
    simulation = Simulation(scene)
    settled = simulation.settle(COMFORT_ARM_DEG)
    names = simulation.joint_names
    angle = np.degrees(settled.joint_position)
    elbow, turned = (names.index(n) for n in (ELBOW, "right_upper_arm_rotation"))
    hinge = scene.hinges[elbow]
    simulation.start()
    load = board_load_n(simulation)
    simulation.advance(round(DRIFT_S / simulation.model.opt.timestep))
    address = [simulation.model.joint(f"human_{n}").qposadr[0] for n in names]
    drift = np.degrees(np.abs(simulation.data.qpos[address] - settled.joint_position)).max()
    spring = hinge.stiffness_nm_rad * float(
        simulation.model.qpos_spring[address[elbow]] - settled.joint_position[elbow]
    )
    return (
        f"| {body} | {name} | {hinge.stiffness_nm_rad:.2f} | {spring:.2f} | {angle[elbow]:.1f} | {angle[turned]:.1f} | "
        f"{settled.comfort_arm_deg:.2f} | {load:.1f} | {drift:.2f} |"
    )


def table(bodies: list[str]) -> None:
    heads = (
        "body", "elbow rests", "stiffness [N m/rad]", "torque at rest [N m]", "elbow [deg]", "shoulder rotation [deg]",
        f"comfort angle [deg] ({COMFORT_ARM_DEG} asked)", "forearm and hand on the board [N]", "drift in 10 s [deg]",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |")
    print("|---|---|---|---|---|---|---|---|---|")
    for body in bodies:
        scene = build_scene(overridden(load_protocol("bathing-v3"), {"person.body": body}), target=None, skin=False)
        print(row(body, resting_where_laid(scene), "where laid"))
        print(row(body, scene, "neutral"))


def passive_nm(hinge: Hinge, angle_deg: np.ndarray) -> np.ndarray:
    """Torque of spring and end stop over the angle; flexion positive."""
    assert hinge.neutral_deg is not None
    angle, (low, high) = np.radians(angle_deg), np.radians(hinge.range_deg)
    stop = end_stop_nm(past_range(angle, np.array(low), np.array(high)), np.array(cubic_nm_rad3(hinge.name)))
    return hinge.stiffness_nm_rad * (np.radians(hinge.neutral_deg) - angle) + stop


KNEE_EXTENSION = (1.800, -0.0352)
"""Riener and Edrich 1999, J Biomech 32:539: exponent of the knee's extension term at ankle and hip 0, over the angle
in degrees; as public implementations of the paper have it."""


def draw(figure) -> None:
    figure.set_size_inches(9.0, 3.2)
    left, right = figure.subplots(1, 2)
    angle = np.linspace(-6, 150, 600)
    for spread in (-NEUTRAL_SPREAD_DEG, NEUTRAL_SPREAD_DEG):
        for stiffness in ELBOW_RANGE_NM_RAD:
            left.plot(angle, stiffness * np.radians(ELBOW_NEUTRAL_DEG + spread - angle), color="0.75", lw=0.7)
    left.plot([], [], color="0.75", lw=0.7, label="Wiegner and Watts 1986:\n0.40 and 1.8 N m/rad, 107 ± 10°")
    for body in ("man-adult-light", "man-adult", "man-adult-heavy"):
        hinge = next(h for h in hinges(load_body(body)) if h.name == ELBOW)
        left.plot(angle, passive_nm(hinge, angle), label=body)
    left.axhline(0.0, color="0.4", lw=0.6)
    left.set(
        xlabel="elbow flexion [deg]", ylabel="passive torque, flexion positive [N m]", ylim=(-3.5, 4), title="elbow"
    )
    left.legend(fontsize="small")
    past = np.linspace(0.0, np.degrees(REACHED_RAD) * 1.3, 200)
    cubic = -end_stop_nm(np.radians(past), np.array(1.0)) / REACHED_RAD**3
    right.plot(past, cubic, label="end stop here: a cubic, the form that\nEngin and Chen 1987 found, strength chosen")
    rate = -KNEE_EXTENSION[1]
    reached = np.degrees(REACHED_RAD)
    right.plot(past, (np.exp(rate * past) - 1) / (np.exp(rate * reached) - 1), "--", color="0.4",
               label="exponential, knee extension,\nRiener and Edrich 1999")  # fmt: skip
    right.set(xlabel="past the range [deg]", ylabel="torque over that at 5°", title="shape of the end stop")
    right.legend(fontsize="small")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bodies", nargs="*", metavar="BODY", help="default: all")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    if arguments.figure:
        draw_figure(draw, arguments.figure)
    else:
        table(arguments.bodies or list(body_names()))


if __name__ == "__main__":
    main()
