"""What a policy would have been sent in a recorded trial, at any time and with any card: pictures for a dataset.

The states between two that the recording stores are stepped again (``replay.replay``), and the observation is built of
each in the same way as in a trial, with the trial's own noise and errors of calibration. Therefore, a picture is the
one that a policy with this card would have received there.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

from carecontact.episode.randomization import calibration, sensor_noise, with_draws_of
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.recording.schema import Recording
from carecontact.replay.replay import STATE, Replay, ReplayQuality
from carecontact.scoring.foam import RecordedWiping
from carecontact.sensing.builder import ObservationBuilder
from carecontact.sensing.keypoints import PoseEstimator
from carecontact.sim.rendering import SceneRenderer


class Resensed:
    """A recorded trial as a policy with another card would have seen it."""

    def __init__(self, recording: Recording, card: PolicyCard) -> None:
        """Raises RecordingError, SceneError and SettleError as ``Replay``."""
        self._recording, self._card, self.quality = recording, card, ReplayQuality()
        self._replay = Replay(recording)

    def observations(self, hz: float) -> Iterator[Observation]:
        """Yield the observation at each k / hz from t = 0 until the last action has ended. Call it once."""
        spec, replay = self._recording.header.spec.opened, self._replay
        simulation, model = replay.simulation, replay.model
        protocol = with_draws_of(spec.protocol, simulation.protocol)
        wiping, foam, shown = RecordedWiping.of(self._recording), replay.scene.foam, None
        data = mujoco.MjData(model)
        known = calibration(protocol, spec.seed, salt=spec.salt)
        with SceneRenderer(model, protocol=protocol, calibration=known) as renderer:
            builder = ObservationBuilder(
                renderer,
                self._card,
                protocol,
                PoseEstimator(),
                noise=sensor_noise(protocol, spec.seed, salt=spec.salt, noise_salt=spec.noise_salt),
            )
            for stretch in replay.stretches(hz):
                self.quality.take(stretch)
                for step, state in zip(stretch.steps, stretch.states, strict=True):
                    if step == replay.step_count:
                        return
                    time_s = float(step) * replay.dt_s
                    if wiping is not None and foam is not None:
                        left = wiping.until(time_s).left
                        if shown is None or (left != shown).any():
                            shown = left.copy()
                            foam.paint(model, shown)
                            renderer.skin_changed()
                    mujoco.mj_setState(model, data, state, STATE)
                    mujoco.mj_kinematics(model, data)
                    mujoco.mj_comPos(model, data)
                    mujoco.mj_camlight(model, data)
                    yield builder.build(data, instruction=protocol.task(spec.task_id).prompt, sim_time_s=time_s)
