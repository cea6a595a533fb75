"""Keeps settled persons between trials, since lying down takes longer than loading the final state.

A file is named by all that the settled state depends on: the compiled model, the comfort angle, the place on the bed,
the settling rules, MuJoCo's version and the compiled tissue. A trial continues from the stored state in the same way
whether it was just computed or read, so the recording is the same bit for bit.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zipfile
from pathlib import Path

import mujoco
import numpy as np

from carecontact.kernel import library
from carecontact.sim.simulation import Settled, Simulation
from carecontact.world.place import place_in_model

CACHE_VARIABLE = "CARECONTACT_CACHE"
"""Environment variable that names the folder; where it is empty, nothing is kept."""


def cache_folder() -> Path | None:
    """Where settled states are kept; None where nothing is to be kept."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "carecontact"


def settle(simulation: Simulation, comfort_arm_deg: float, *, model_sha256: str) -> Settled:
    """Settle the person, or load what ``simulation.settle`` gave before for the same model and angle. Raises
    SettleError as it does.

    Args:
        model_sha256: of the scene before anything was changed in it.
    """
    folder = cache_folder()
    path = None
    if folder is not None:
        path = folder / "settled" / f"{_key(simulation, comfort_arm_deg, model_sha256)}.npz"
        if known := _read(path, simulation):
            state, settled = known
            simulation.restore(state, comfort_arm_deg=comfort_arm_deg)
            return settled
    settled = simulation.settle(comfort_arm_deg)
    state = simulation.integration_state()
    simulation.restore(state, comfort_arm_deg=comfort_arm_deg)
    if path is not None:
        _write(path, state, settled)
    return settled


def _key(simulation: Simulation, comfort_arm_deg: float, model_sha256: str) -> str:
    protocol = simulation.protocol
    facts = {
        "model": model_sha256, "mujoco": mujoco.__version__, "kernel": library.sha256(),
        "comfort_arm_deg": comfort_arm_deg.hex(),
        "phases": protocol.phases.model_dump(mode="json"), "target_period_s": protocol.physics.target_period_s,
        "parked": protocol.scene.parked_joint_rad, "place": [v.hex() for v in place_in_model(simulation.model)],
    }  # fmt: skip
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def _read(path: Path, simulation: Simulation) -> tuple[np.ndarray, Settled] | None:
    """None where the file is missing or not whole; the caller then computes the state again."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            state = stored["state"]
            settled = Settled(
                duration_s=float(stored["duration_s"]), comfort_arm_deg=float(stored["comfort_arm_deg"]),
                joint_position=stored["joint_position"], wrist_in_world=stored["wrist_in_world"],
            )  # fmt: skip
            whole = str(stored["sha256"]) == _digest(state, settled)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    size = mujoco.mj_stateSize(simulation.model, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    return (state, settled) if whole and state.shape == (size,) else None


def _write(path: Path, state: np.ndarray, settled: Settled) -> None:
    """Write the file whole or not at all, since trials run at the same time. Where the folder cannot be written, only
    time is lost."""
    arrays = {
        "state": state, "duration_s": settled.duration_s, "comfort_arm_deg": settled.comfort_arm_deg,
        "joint_position": settled.joint_position, "wrist_in_world": settled.wrist_in_world,
        "sha256": _digest(state, settled),
    }  # fmt: skip
    part = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            part = Path(file.name)
            np.savez(file, **arrays)
        os.replace(part, path)
    except OSError:
        if part is not None:
            part.unlink(missing_ok=True)


def _digest(state: np.ndarray, settled: Settled) -> str:
    numbers = [state, [settled.duration_s, settled.comfort_arm_deg], settled.joint_position, settled.wrist_in_world]
    return hashlib.sha256(b"".join(np.asarray(n, "<f8").tobytes() for n in numbers)).hexdigest()
