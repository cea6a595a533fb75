from __future__ import annotations

from pathlib import Path

import numpy as np

from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Variation
from carecontact.contract.trial import TrialSpec
from carecontact.episode.first_look import first_look
from carecontact.hosting.setup import PolicySetup
from carecontact.protocols import load_protocol
from carecontact.recording.perception import perception_errors
from carecontact.trials.trial import run_trial

POLICY = """
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

class Once:
    card = PolicyCard(name="once", modalities=("rgb", "depth"), cameras=("overhead", "wrist"))
    def reset(self, instruction): ...
    def act(self, observation):
        return Action(done=True)
"""


def test_it_is_what_the_trial_shows_with_every_variation_on(tmp_path: Path) -> None:
    variation = Variation(
        appearance="varied-v1", light="varied-v1", depth_noise="structured-light-v1", encoder_noise_rad=0.003,
        place_along_m=0.04, place_across_m=0.03, place_yaw_deg=5.0,
    )  # fmt: skip
    protocol = load_protocol().model_copy(update={"variation": variation})
    (tmp_path / "look_once.py").write_text(POLICY)
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=2, policy="look_once:Once")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(tmp_path)]))
    card = PolicyCard(name="once", modalities=("rgb", "depth"), cameras=("overhead", "wrist"))
    seen = first_look(protocol, task_id="T1", seed=2, card=card)
    for camera, view in seen.cameras.items():
        for modality in ("rgb", "depth"):
            stored = recording[f"policy/frames/0000/{camera}/{modality}"]
            np.testing.assert_array_equal(getattr(view, modality), stored)
    # What nobody asked for was neither rendered nor measured: 2 RGB and 2 depth; and two pictures for the report.
    assert recording["wall/renders"].tolist() == [2, 2, 0, 0, 0]
    assert recording["wall/report_renders"].tolist() == [2]
    assert perception_errors(recording) is None

    plain = first_look(load_protocol(), task_id="T1", seed=2, card=card)
    away = seen.joint_position - plain.joint_position
    assert 0.0005 < np.abs(away).mean() < 0.01
    # The hand's pose and its camera follow the encoders, wrong as they are.
    shift = seen.pose_tcp_in_base[:3] - plain.pose_tcp_in_base[:3]
    assert 1e-4 < np.linalg.norm(shift) < 0.02
    moved = [v.pose_camera_in_base[:3, 3] for v in (seen.cameras["wrist"], plain.cameras["wrist"])]
    assert np.linalg.norm(moved[0] - moved[1]) > 1e-4
    overhead = [v.cameras["overhead"] for v in (seen, plain)]
    np.testing.assert_array_equal(overhead[0].pose_camera_in_base, overhead[1].pose_camera_in_base)
    assert overhead[0].rgb is not None
    assert overhead[1].rgb is not None
    assert (overhead[0].rgb != overhead[1].rgb).any(2).mean() > 0.5
