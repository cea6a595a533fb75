"""A folder holds trials of one language backend."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.recording import Recording, write_recording
from carecontact.runs.identity import identity_of
from carecontact.runs.manifest import read_manifest, survey, write_manifest
from carecontact.runs.plan import plan_trials
from carecontact.trials.failed import harness_error_recording

SPECS = plan_trials(protocol=load_protocol(), policy="state-machine", tasks=["T1"], seeds=[0])


def identity(language: str | None):
    return identity_of(SPECS[0], search_path=[], language=language)


def test_the_manifest_tells_which_one(tmp_path: Path) -> None:
    for language in ("rules-v1", "live:m-1"):
        write_manifest(SPECS, out=tmp_path, identity=identity(language), purpose="run")
        manifest = read_manifest(tmp_path)
        assert manifest is not None
        assert manifest.identity.language == language


@pytest.mark.parametrize(("before", "now"), [("rules-v1", None), (None, "rules-v1"), ("live:m-1", "live:m-2")])
def test_another_one_needs_another_folder(tmp_path: Path, before: str | None, now: str | None) -> None:
    write_manifest(SPECS, out=tmp_path, identity=identity(before), purpose="run")
    assert not survey(SPECS, out=tmp_path, retry_failed=False, identity=identity(before)).redo
    with pytest.raises(ConfigError, match=r"was started with language backend .*: use another folder"):
        survey(SPECS, out=tmp_path, retry_failed=False, identity=identity(now))


def test_a_recording_of_another_one_is_told_without_a_manifest(tmp_path: Path) -> None:
    failed = harness_error_recording(SPECS[0], kind="x", message="x")
    header = failed.header.model_copy(update={"card": {"language_backend": "rules-v1"}, "ended": "done"})
    write_recording(Recording(header=header, arrays=failed.arrays), tmp_path / "T1-s000.h5")
    assert survey(SPECS, out=tmp_path, retry_failed=False, identity=identity("rules-v1")).keep
    with pytest.raises(ConfigError, match="recorded with language backend rules-v1"):
        survey(SPECS, out=tmp_path, retry_failed=False, identity=identity("live:m-1"))
