"""Whether a run was made with the secret that it committed to."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carecontact.episode.randomization import calibration, drawn, drawn_facts, streams
from carecontact.errors import ConfigError
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.policy import CAMERAS
from carecontact.protocol.protocol import commitment
from carecontact.recording import Recording, read_recording
from carecontact.runs.manifest import MANIFEST, committed
from carecontact.sensing.calibration import BELIEVED, TRUE, Calibration
from carecontact.world.draws import arm_bias_of, draw_shifts

OF_THE_WORLD = "body, posture, place, robot's base, bias of its arm, or camera"
ARM_DEG = 3.0
"""How far [deg] from the drawn angle an arm may come to rest (assumed)."""
SAME = 1e-9


@dataclass(frozen=True, kw_only=True)
class Verified:
    sha256: str
    recordings: int
    draws: int
    """Number of draws that recordings hold and that were drawn again: persons, calibrations, changes of posture."""
    faults: tuple[str, ...]


def verify_salt(run: Path) -> Verified:
    """Check the revealed secret of a run, and every recording, against the hash that the run committed to."""
    manifest = committed(run)
    if not manifest.salt:
        raise ConfigError(f"{run}: the salt is not revealed yet; its owner runs `carecontact protocol salt reveal`")
    faults: list[str] = []
    if commitment(manifest.salt) != manifest.salt_sha256:
        revealed, hashed = f"{MANIFEST}: the sha256 of the revealed salt is", commitment(manifest.salt)
        faults.append(f"{revealed} {hashed}, and the run committed to {manifest.salt_sha256}")
    recordings = draws = 0
    for path in sorted(run.glob("*.h5")):
        recording = read_recording(path)
        recordings += 1
        named = recording.header.spec.salt_sha256
        if named != manifest.salt_sha256:
            faults.append(f"{path.name}: it names the salt {named or 'none'}, and the run {manifest.salt_sha256}")
        for what, same in drawn_again(recording, manifest.salt):
            draws += 1
            if not same:
                faults.append(f"{path.name}: {what} does not follow from the revealed salt")
    return Verified(sha256=manifest.salt_sha256, recordings=recordings, draws=draws, faults=tuple(faults))


def drawn_again(recording: Recording, salt: str) -> Iterator[tuple[str, bool]]:
    """Yield the name of each draw that a recording holds, and whether the salt gives the same draw."""
    header, arrays = recording.header, recording.arrays
    protocol, seed = header.spec.protocol, header.spec.seed
    made = drawn(header.spec.model_copy(update={"salt": salt}))
    if header.comfort_arm_deg is not None:
        yield "the angle of the arm", abs(header.comfort_arm_deg - made.comfort_arm_deg) < ARM_DEG
    if header.drawn:
        facts = json.loads(json.dumps(drawn_facts(made.protocol, made.place, arm_bias_of(protocol, seed, salt))))
        yield OF_THE_WORLD, header.drawn == facts
    if BELIEVED in arrays:
        yield "the error of the calibration", _same_errors(recording, calibration(protocol, seed, salt=salt))
    wanted = protocol.person.alive.repositioning
    if wanted is not None and "scorer/repositioning_s" in arrays:
        rng = streams(protocol, seed, salt)["repositioning"]
        times = [shift.time_s for shift in draw_shifts(rng, wanted, until_s=protocol.phases.time_limit_s)]
        yield "when the person changes its posture", np.array_equal(times, arrays["scorer/repositioning_s"])


def _same_errors(recording: Recording, known: Calibration) -> bool:
    """Whether the recorded belief about every fixed camera's pose agrees with its drawn error."""
    for beliefs, truths in zip(recording[BELIEVED], recording[TRUE], strict=True):
        for name, error in known.items():
            believed, place = (row[CAMERAS.index(name)] for row in (beliefs, truths))
            if np.isnan(believed).all():
                continue
            away = pose_matrix(place[:3], place[3:]) @ error - pose_matrix(believed[:3], believed[3:])
            if not np.abs(away).max() < SAME:
                return False
    return True
