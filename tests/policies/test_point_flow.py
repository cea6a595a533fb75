"""The policy that was learned: what it sees, what its networks answer, and what it does in the exam."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.errors import ConfigError
from carecontact.policies.point_flow import (
    CHUNK,
    EXECUTED,
    NUMBERS,
    OUTPUTS,
    POINTS,
    SMALL_M,
    VECTORS,
    PointFlow,
    cloud,
    targets,
    travelled,
    turn,
)
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.scoring import score_recording
from tests.policies.synthetic import synthetic_observation, synthetic_view

POSE = np.array([0.4, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0])


def what_it_sees() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    first, last = (rng.random((POINTS, 6)).astype("f4") for _ in range(2))
    return first, last, rng.random(NUMBERS).astype("f4"), rng.standard_normal((VECTORS, 3)).astype("f4")


def test_the_networks_answer_as_they_did_in_pytorch() -> None:
    """Values of examples/learn/point_flow.py with the shipped weights, in torch 2.13."""
    out = PointFlow().differences(*what_it_sees())
    assert out.shape == (OUTPUTS,)
    golden = [-1.23911, 1.48744, 1.67937, -0.37598, -1.43659, 0.27959, 2.45272]
    np.testing.assert_allclose(out[[0, 1, 2, 60, 61, 62, -1]], golden, atol=2e-5)


def test_they_answer_as_in_pytorch_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples/learn")
    import point_flow  # pyright: ignore[reportMissingImports]

    policy = PointFlow()
    kept = {name: torch.from_numpy(value) for name, value in policy._kept.items()}
    scale, network = kept.pop("scale"), point_flow.Flow().eval()
    network.load_state_dict(kept)
    first, last, numbers, vectors = (torch.from_numpy(part)[None] for part in what_it_sees())
    with torch.no_grad():
        seen = network.encoder(point_flow.relative(first, last, vectors), numbers, vectors)
        at = torch.zeros(1, OUTPUTS)
        for step in range(10):
            at = at + network(at, torch.full((1, 1), step / 10), seen) / 10
    np.testing.assert_allclose(policy.differences(*what_it_sees()), (at[0] * scale).numpy(), atol=2e-5)
    for name in ("point_flow", "demonstrations"):
        sys.modules.pop(name)


def test_differences_become_targets_from_the_last_one() -> None:
    differences = np.zeros(OUTPUTS)
    differences[: 3 * CHUNK : 3] = np.arcsinh(0.010 / SMALL_M)
    differences[3 * CHUNK + 2 : 6 * CHUNK : 3] = np.arcsinh(0.1 / 0.02)
    wanted = targets(POSE, differences, np.eye(3))
    assert len(wanted) == EXECUTED
    np.testing.assert_allclose(wanted[0][:3], POSE[:3] + [0.010, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn(POSE, wanted[0]), [0, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(travelled(wanted, POSE), [0.010] * EXECUTED, atol=1e-12)


def test_a_cloud_takes_colourful_points_that_the_arm_might_reach() -> None:
    view = synthetic_view(points=4000)
    assert view.points is not None
    assert view.point_colors is not None
    view.point_colors[:] = 200
    view.point_colors[:1000] = (250, 60, 60)
    view.points[:2000] *= 0.1
    chosen = cloud(view)
    assert chosen.shape == (POINTS, 6)
    assert (np.linalg.norm(chosen[:, :3], axis=1) < 1).all()
    assert (chosen[:, 3] > 0.9).mean() > 0.9


def test_a_cloud_without_anything_near_has_its_size() -> None:
    view = synthetic_view()
    assert view.points is not None
    view.points[:] = 9.0
    assert cloud(view).shape == (POINTS, 6)


def test_it_ends_when_nothing_is_left_but_not_in_the_first_five_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PointFlow, "differences", lambda *_: np.zeros(OUTPUTS, "f4"))
    policy = PointFlow()
    policy.reset("gently touch the right forearm")
    seen = synthetic_observation(cameras={"overhead": synthetic_view()})
    done = [[action.done for action in policy.act(seen)] for _ in range(12)]
    assert [any(chunk) for chunk in done] == [False] * 11 + [True]
    assert done[-1] == [False] * (EXECUTED - 1) + [True]


@pytest.mark.parametrize("instruction", ["push the right forearm", "gently scrub the abdomen"])
def test_it_does_nothing_that_it_has_not_learned(instruction: str) -> None:
    policy = PointFlow()
    policy.reset(instruction)
    (action,) = policy.act(synthetic_observation(cameras={"overhead": synthetic_view()}))
    assert action.done
    assert action.pose_tcp_in_base is None


def test_a_file_without_weights_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bc.npz"
    for arrays in ({}, {"trained_on": np.array(["a"])}):
        np.savez(path, **arrays)
        with pytest.raises(ConfigError, match=r"bc\.npz: no weights"):
            PointFlow(weights=str(path))
    for text in ("nothing", "", "PK\3\4 no zip"):
        path.write_text(text)
        with pytest.raises(ConfigError, match="no weights"):
            PointFlow(weights=str(path))
    with pytest.raises(ConfigError, match=r"nowhere\.npz: No such file"):
        PointFlow(weights=str(tmp_path / "nowhere.npz"))


def test_it_touches_a_forearm_of_a_development_seed() -> None:
    policy = PointFlow()
    spec = TrialSpec(
        protocol=load_protocol("bathing-wide-v2", level="L1"), task_id="T1", seed=0, policy=policy.card.name
    )
    with Episode(spec, card=policy.card) as episode:
        policy.reset(episode.instruction)
        observation = episode.reset()
        while observation is not None:
            chunk, step = policy.act(observation), None
            for number, action in enumerate(chunk, start=1):
                step = episode.step(action, observe=number == len(chunk))
                if step.reason is not None:
                    break
            observation = None if step is None else step.observation
        score = score_recording(episode.finish())
    assert score.region_correct
