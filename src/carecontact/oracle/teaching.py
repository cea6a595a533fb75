"""How demonstrations differ from a plain run: noise on the targets, or the oracle's labels on another policy's actions.

In both cases an action is executed that the demonstrator did not choose, and the recording holds what it chose
(``actions/demonstrated``): where the target was disturbed, the target before that, and where another policy acted, the
oracle's from the same state. A learner of such pairs sees states that a perfect demonstrator never reaches.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from carecontact.episode.episode import Episode, Teaching
from carecontact.errors import ConfigError
from carecontact.interface.action import Action
from carecontact.interface.action_spaces import clip_action
from carecontact.interface.geometry import quat_from_matrix
from carecontact.oracle.policy import Oracle
from carecontact.policies.motion import CONTROL_HZ
from carecontact.world.draws import words

F64 = npt.NDArray[np.float64]

NOISE_S = 0.8
"""Time [s] over which the noise forgets where it was: twice the lag of the tool behind its target, so that the tool
follows it and the demonstrator's next targets bring the tool back."""
POSES = "cartesian_pose"
REACH_M = 0.12
"""The oracle's target waits while the tool is farther [m] from it: more than the 0.09 m that a tool lags behind a
target at full speed."""
STRAYED_S = 1.0
"""The oracle plans from where the tool is after it was out of reach for this time [s]."""


def teaching_of(variant: str, episode: Episode) -> Teaching:
    """Return how a variant of a policy (``interface.policy.VARIANT``) turns its actions into demonstrations.

    Raises ConfigError for a policy that does not command the tool's pose.
    """
    assert episode.card is not None
    if episode.card.action_space != POSES:
        raise ConfigError(
            f"{variant}: demonstrations are poses of the tool ({POSES}), and {episode.card.name} has the action space "
            f"{episode.card.action_space}"
        )
    return _labelled(episode) if variant == "dagger" else _disturbed(episode, mm=float(variant[6:-2]))


def _disturbed(episode: Episode, *, mm: float) -> Teaching:
    """Add Ornstein-Uhlenbeck noise to the position of every target.

    Args:
        mm: standard deviation of each coordinate [mm]. Task, seed and salt of the trial decide the noise.
    """
    spec, bounds = episode.spec, episode.session.action_bounds
    rng = np.random.default_rng(words(f"{spec.salt} {spec.protocol.drawn_as} {spec.seed} {spec.task_id} targets"))
    assert episode.card is not None
    kept = float(np.exp(-1.0 / (episode.card.control_hz * NOISE_S)))
    # From nothing on, since the trial begins where the robot is parked.
    off_m, last = np.zeros(3), episode.simulation.control.target_in_base.copy()

    def teach(action: Action) -> tuple[Action, Action]:
        nonlocal off_m, last
        off_m = kept * off_m + np.sqrt(1 - kept**2) * mm / 1000 * rng.standard_normal(3)
        last = last if action.pose_tcp_in_base is None else action.pose_tcp_in_base
        executed = replace(action, pose_tcp_in_base=np.concatenate([last[:3] + off_m, last[3:]]))
        return clip_action(executed, bounds), replace(action, pose_tcp_in_base=last)

    return teach


def _labelled(episode: Episode) -> Teaching:
    """Label every action of the acting policy with the oracle's target from the same state. The oracle waits for a tool
    that is led elsewhere, and begins again there if it stays away."""
    simulation, away_s, label = episode.simulation, 0.0, Action()

    def planned() -> Oracle:
        return Oracle(simulation, episode.task, episode.session.action_bounds)

    oracle, due_s = planned(), 0.0

    def teach(action: Action) -> tuple[Action, Action]:
        nonlocal oracle, due_s, away_s, label
        while due_s <= simulation.time_s + 1e-9:
            due_s += 1 / CONTROL_HZ
            pose = simulation.encoders.pose_tcp_in_base(simulation.data)
            tool = np.concatenate([pose[:3, 3], quat_from_matrix(pose[:3, :3])])
            target = label.pose_tcp_in_base
            near = target is None or float(np.linalg.norm(tool[:3] - target[:3])) <= REACH_M
            away_s = 0.0 if near else away_s + 1 / CONTROL_HZ
            if away_s > STRAYED_S:
                oracle, away_s, near, label = planned(), 0.0, True, Action()
            if near and not label.done:
                label = oracle.target(tool, simulation.time_s)
        return action, label

    return teach
