"""A made-up schema 0: no comfort arm in the header, and forces in kilonewtons under another name."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from carecontact.errors import RecordingError, SceneError
from carecontact.kernel.region import Law
from carecontact.recording import MIGRATIONS, SCHEMA_VERSION, RawRecording, canonical_hash, read_recording
from carecontact.recording.canonical import header_json
from carecontact.runs import score_run, write_scores
from tests.recording.raw_file import store
from tests.scoring.synthetic import touch

OLD, NEW_NAME, OLD_NAME = "carecontact-recording-0", "scorer/normal_force", "scorer/normal_force_kn"


def from_zero(raw: RawRecording) -> RawRecording:
    arrays = dict(raw.arrays)
    arrays[NEW_NAME] = (arrays.pop(OLD_NAME) * 1000.0).astype(np.float32)
    header = {**raw.header, "schema_version": SCHEMA_VERSION, "comfort_arm_deg": raw.header.get("arm", 50.0)}
    return RawRecording(header=header, arrays=arrays)


@pytest.fixture
def old_file(tmp_path: Path) -> Path:
    recording = touch()
    header = json.loads(header_json(recording.header))
    header["schema_version"] = OLD
    del header["comfort_arm_deg"]
    arrays = dict(recording.arrays)
    arrays[OLD_NAME] = arrays.pop(NEW_NAME).astype(np.float64) / 1000.0
    return store(tmp_path / "T1-s000.h5", header, arrays)


def test_an_older_recording_is_lifted_and_scores_like_its_like(old_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MIGRATIONS, OLD, from_zero)
    before = old_file.read_bytes()
    recording = read_recording(old_file)
    assert recording.header.schema_version == SCHEMA_VERSION
    assert canonical_hash(recording) == canonical_hash(touch())
    run = score_run(old_file.parent)
    assert run.skipped == {}
    assert run.scores[0].c1_peak_force_n == 5.0
    assert old_file.read_bytes() == before, "reading does not rewrite a file"
    path = write_scores(old_file.parent, run)
    assert write_scores(old_file.parent, score_run(old_file.parent)).read_bytes() == path.read_bytes()


def test_without_a_migration_the_version_is_named(old_file: Path) -> None:
    with pytest.raises(RecordingError, match=rf"T1-s000\.h5: schema '{OLD}'; this release reads '{SCHEMA_VERSION}'"):
        read_recording(old_file)


def test_the_checksum_is_that_of_the_file_as_it_was_written(old_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MIGRATIONS, OLD, from_zero)
    with h5py.File(old_file, "r+") as file:
        file[OLD_NAME][700, 3] = 0.001
    with pytest.raises(RecordingError, match="checksum"):
        read_recording(old_file)


def test_migrations_chain(old_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def half(raw: RawRecording) -> RawRecording:
        return RawRecording(header={**raw.header, "schema_version": "carecontact-recording-0.5"}, arrays=raw.arrays)

    monkeypatch.setitem(MIGRATIONS, OLD, half)
    monkeypatch.setitem(MIGRATIONS, "carecontact-recording-0.5", from_zero)
    assert canonical_hash(read_recording(old_file)) == canonical_hash(touch())


@pytest.mark.parametrize(
    ("migration", "told"),
    [
        (lambda raw: raw, "migrations go in a circle"),
        (lambda raw: RawRecording(header={}, arrays={}), "schema None"),
        (lambda raw: RawRecording(header={"schema_version": SCHEMA_VERSION}, arrays={}), "header field"),
        (lambda raw: raw.arrays["gone"], r"cannot be migrated from schema .*KeyError: 'gone'"),
    ],
)
def test_a_migration_that_fails_is_named(old_file: Path, monkeypatch: pytest.MonkeyPatch, migration, told) -> None:
    monkeypatch.setitem(MIGRATIONS, OLD, migration)
    with pytest.raises(RecordingError, match=rf"T1-s000\.h5: .*{told}"):
        read_recording(old_file)


def test_a_header_of_another_spelling_is_the_same_recording(tmp_path: Path) -> None:
    """The checksum covers the bytes that were written, so that a later release need not spell a header alike."""
    header = json.loads(header_json(touch().header))
    del header["spec"]["protocol"]["overrides"]
    recording = read_recording(store(tmp_path / "T1-s000.h5", header, touch().arrays))
    assert canonical_hash(recording) == canonical_hash(touch())


def earlier_rules() -> dict[str, Any]:
    """A header of schema 2, whose rows of tissue had coarser meshes and no contact layer."""
    header = json.loads(header_json(touch().header)) | {"schema_version": "carecontact-recording-2"}
    for row in header["spec"]["protocol"]["person"]["tissue"].values():
        del row["contact_n_m3"]
        row |= {"off_target_spacing_m": 0.028, "off_target_scale": 0.369}
    return header


def test_schema_2_loses_the_coarse_meshes_and_its_contact_layer_is_no_number(tmp_path: Path) -> None:
    header = earlier_rules()
    written = header["spec"]["protocol"]
    lifted = read_recording(store(tmp_path / "T1-s000.h5", header, touch().arrays)).header
    assert lifted.schema_version == SCHEMA_VERSION
    now = touch().header.spec.protocol.person.tissue
    for region, row in lifted.spec.protocol.person.tissue.items():
        assert row == now[region].model_copy(update={"contact_n_m3": None})
    # The hash is that of the rules as they were written, whatever the header says of it.
    rules = {name: value for name, value in written.items() if name != "overrides"}
    assert lifted.protocol_sha256 == hashlib.sha256(json.dumps(rules, sort_keys=True).encode()).hexdigest()
    assert lifted.protocol_sha256 != lifted.spec.protocol.sha256
    with pytest.raises(SceneError, match="made with the earlier model of the tissue"):
        Law.of(lifted.spec.protocol.person.tissue["forearm"])


def test_the_hash_of_rules_of_today_is_their_own(tmp_path: Path) -> None:
    header = json.loads(header_json(touch().header)) | {"schema_version": "carecontact-recording-2"}
    header["sha256"]["protocol"] = "0" * 64
    lifted = read_recording(store(tmp_path / "T1-s000.h5", header, touch().arrays)).header
    assert lifted.protocol_sha256 == touch().header.spec.protocol.sha256


@pytest.mark.parametrize(("card", "control"), [({"name": "p"}, "cartesian-impedance"), (None, None)])
def test_schema_1_is_lifted_with_the_controller_that_every_trial_had(
    tmp_path: Path, card: dict | None, control: str | None
) -> None:
    header = json.loads(header_json(touch().header)) | {"schema_version": "carecontact-recording-1", "card": card}
    del header["control"]
    recording = read_recording(store(tmp_path / "T1-s000.h5", header, touch().arrays))
    assert (recording.header.schema_version, recording.header.control) == (SCHEMA_VERSION, control)
    assert recording.arrays.keys() == touch().arrays.keys()
