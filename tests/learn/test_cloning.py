"""The example that clones: its network learns, and its rows become targets."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.policies.synthetic import synthetic_observation


@pytest.fixture
def cloning(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples/learn")
    import bc_lowdim  # pyright: ignore[reportMissingImports]

    yield bc_lowdim
    for name in ("bc_lowdim", "demonstrations"):
        sys.modules.pop(name)


def test_the_network_learns_what_is_not_linear(cloning: ModuleType) -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2000, 3)).astype("f4")
    y = np.stack([np.sin(2 * x[:, 0]), x[:, 1] * x[:, 2]], 1)
    weights = cloning.train(x, y, width=32, steps=800, batch=128)
    new = rng.standard_normal((500, 3)).astype("f4")
    wanted = np.stack([np.sin(2 * new[:, 0]), new[:, 1] * new[:, 2]], 1)
    off = np.abs(cloning.forward(weights, new) - wanted).mean(0)
    assert (off < 0.3 * np.abs(wanted).mean(0)).all()


def test_rows_become_targets_from_the_last_one(
    cloning: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The network always answers that the next targets lie 10 mm further along the limb, which lies across the base."""
    axes = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    place = SimpleNamespace(axes=axes, at=lambda point: axes @ point, numbers=np.zeros(27))
    monkeypatch.setattr(cloning, "Place", lambda seen: place)
    always = np.zeros(6 * cloning.CHUNK + 1)
    always[: 3 * cloning.CHUNK : 3] = np.arcsinh(0.010 / cloning.SMALL_M)
    scale = {"mean_x": np.zeros(43), "std_x": np.ones(43), "mean_y": always, "std_y": np.ones(always.shape)}
    np.savez(
        tmp_path / "w.npz",
        trained_on=np.array(["a" * 64]),
        w0=np.zeros((43, len(always))),
        w1=np.zeros(len(always)),
        **scale,
    )
    policy = cloning.BehaviourCloning(weights=str(tmp_path / "w.npz"))
    policy.reset("gently touch the right forearm")
    seen = synthetic_observation()
    for turn in (1, 2):
        actions = policy.act(seen)
        assert len(actions) == cloning.EXECUTED
        expected = seen.pose_tcp_in_base + np.array([0, 0.010 * turn, 0, 0, 0, 0, 0])
        np.testing.assert_allclose(actions[-1].pose_tcp_in_base, expected, atol=1e-9)
        assert not actions[-1].done
    done = [policy.act(seen)[-1].done for _ in range(10)]
    assert done == [False] * 9 + [True], "it may end after five seconds"
