from __future__ import annotations

import numpy as np

from carecontact.contract.protocol import Protocol
from carecontact.observation.calibration import draw_calibration
from carecontact.protocols import load_protocol


def erring(shift_m: float, turn_deg: float) -> Protocol:
    protocol = load_protocol()
    varied = protocol.variation.model_copy(update={"calibration_m": shift_m, "calibration_deg": turn_deg})
    return protocol.model_copy(update={"variation": varied})


def test_without_an_error_no_camera_has_one() -> None:
    assert draw_calibration(np.random.default_rng(0), load_protocol()) == {}


def test_every_fixed_camera_errs_as_the_protocol_says_and_the_hands_does_not() -> None:
    draws = [draw_calibration(np.random.default_rng(k), erring(0.003, 0.2)) for k in range(400)]
    assert {frozenset(found) for found in draws} == {frozenset(("overhead", "bedside", "exterior"))}
    errors = np.array([list(found.values()) for found in draws])
    np.testing.assert_allclose(errors[..., :3, 3].std((0, 1)), 0.003, rtol=0.08)
    turn = np.degrees(np.stack([errors[..., 2, 1], errors[..., 0, 2], errors[..., 1, 0]], -1))
    np.testing.assert_allclose(turn.std((0, 1)), 0.2, rtol=0.08)
    gram = errors[..., :3, :3] @ errors[..., :3, :3].swapaxes(-1, -2)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-12)
    flat = np.concatenate([errors[..., :3, 3].reshape(len(draws), -1), turn.reshape(len(draws), -1)], 1)
    assert np.abs(np.corrcoef(flat.T) - np.eye(18)).max() < 0.25


def test_a_camera_has_the_same_error_whichever_others_there_are() -> None:
    protocol = erring(0.003, 0.2)
    alone = protocol.model_copy(update={"cameras": {"exterior": protocol.cameras["exterior"]}})
    found = draw_calibration(np.random.default_rng(5), alone)
    assert list(found) == ["exterior"]
    np.testing.assert_array_equal(
        found["exterior"], draw_calibration(np.random.default_rng(5), protocol)["exterior"]
    )  # fmt: skip
