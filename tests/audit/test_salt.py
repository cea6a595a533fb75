from __future__ import annotations

import pytest

from carecontact.audit.salt import drawn_again
from carecontact.episode.episode import Episode
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import Alive, Repositioning
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording

SALT = "5a" * 32


@pytest.fixture(scope="module")
def recording() -> Recording:
    protocol = load_protocol("bathing-v3")
    varied = protocol.model_copy(
        update={
            "variation": protocol.variation.model_copy(update={"calibration_m": 0.003, "calibration_deg": 0.2}),
            "person": protocol.person.model_copy(update={"alive": Alive(repositioning=Repositioning())}),
        }
    )
    spec = TrialSpec(protocol=varied, task_id="T1", seed=1, policy="x", salt=SALT)
    card = PolicyCard(name="x", modalities=("depth",), control_hz=20.0)
    with Episode(spec, card=card) as episode:
        episode.reset()
        episode.step(Action(done=True))
        return episode.finish()


def test_a_recording_names_its_salt_by_its_hash(recording: Recording) -> None:
    spec = recording.header.spec
    assert (spec.salt, len(spec.salt_sha256)) == ("", 64)


@pytest.mark.parametrize(("salt", "same"), [(SALT, True), ("5b" * 32, False), ("", False)])
def test_what_a_recording_holds_of_its_draws_follows_from_its_salt_alone(
    recording: Recording, salt: str, same: bool
) -> None:
    found = dict(drawn_again(recording, salt))
    assert set(found) == {
        "the angle of the arm", "the error of the calibration", "when the person changes its posture"
    }  # fmt: skip
    assert found.pop("the angle of the arm") or not same
    assert set(found.values()) == {same}
