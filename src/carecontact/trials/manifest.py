"""What a run folder holds, and what of it another command may keep."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import read_recording
from carecontact.recording.schema import EndReason

MANIFEST = "manifest.json"
MANIFEST_SCHEMA = "carecontact-run-1"
FAILED: tuple[EndReason, ...] = ("process_failure", "harness_error")


@dataclass(frozen=True, kw_only=True)
class Survey:
    """Of a run folder, against the trials that are wanted."""

    keep: dict[str, EndReason]
    """Trial id -> how it ended."""
    redo: dict[str, str]
    """Trial id -> why the file that is there does not count."""


def survey(specs: Sequence[TrialSpec], *, out: Path, retry_failed: bool) -> Survey:
    """Sort the wanted trials that have a file in ``out`` into those to keep and those to run again.

    Raises ConfigError when the folder holds a run of another policy or protocol.
    """
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    if any((spec.policy, spec.protocol) != (specs[0].policy, specs[0].protocol) for spec in specs):
        raise ConfigError("a run has one policy and one protocol")
    if len({spec.trial_id for spec in specs}) != len(specs):
        raise ConfigError("the same trial is planned twice")
    _check_manifest(specs[0], out=out)
    wanted = {spec.trial_id for spec in specs}
    keep: dict[str, EndReason] = {}
    redo: dict[str, str] = {}
    for path in sorted(out.glob("*.h5")):
        try:
            header = read_recording(path).header
        except RecordingError as error:
            if path.stem in wanted:
                redo[path.stem] = str(error)
            continue
        if (header.spec.policy, header.spec.protocol) != (specs[0].policy, specs[0].protocol):
            raise _another_run(out, held=header.spec, wanted=specs[0], evidence=path.name)
        if path.stem not in wanted:
            continue
        if header.spec.trial_id != path.stem:
            redo[path.stem] = f"{path.name} holds trial {header.spec.trial_id}"
        elif retry_failed and header.ended in FAILED:
            redo[path.stem] = f"ended as {header.ended}"
        else:
            keep[path.stem] = header.ended
    return Survey(keep=keep, redo=redo)


def write_manifest(specs: Sequence[TrialSpec], *, out: Path) -> None:
    """Atomically; trials of earlier commands in the same folder stay listed."""
    protocol = specs[0].protocol
    earlier = (_read_manifest(out) or {}).get("trials", [])
    content = {
        "schema": MANIFEST_SCHEMA,
        "policy": specs[0].policy,
        "protocol": {"id": protocol.id, "sha256": protocol.sha256},
        "trials": sorted({*earlier, *(spec.trial_id for spec in specs)}),
    }
    partial = out / f".{MANIFEST}.partial"
    partial.write_text(json.dumps(content, indent=2) + "\n")
    os.replace(partial, out / MANIFEST)


def _check_manifest(spec: TrialSpec, *, out: Path) -> None:
    held = _read_manifest(out)
    if held is None:
        return
    same = held.get("policy") == spec.policy and held.get("protocol", {}).get("sha256") == spec.protocol.sha256
    if not same:
        raise ConfigError(
            f"{out} holds another run (policy {held.get('policy')}, protocol {held.get('protocol', {}).get('id')} "
            f"{str(held.get('protocol', {}).get('sha256'))[:12]}); wanted policy {spec.policy}, protocol "
            f"{spec.protocol.id} {spec.protocol.sha256[:12]}: use another --out"
        )


def _read_manifest(out: Path) -> dict | None:
    """None when there is none or it cannot be read: the recordings say themselves what they are."""
    try:
        held = json.loads((out / MANIFEST).read_bytes())
    except (FileNotFoundError, ValueError):
        return None
    return held if isinstance(held, dict) and held.get("schema") == MANIFEST_SCHEMA else None


def _another_run(out: Path, *, held: TrialSpec, wanted: TrialSpec, evidence: str) -> ConfigError:
    def told(spec: TrialSpec) -> str:
        return f"policy {spec.policy}, protocol {spec.protocol.id} {spec.protocol.sha256[:12]}"

    return ConfigError(
        f"{out} holds another run: {evidence} is of {told(held)}; wanted {told(wanted)}: use another --out"
    )
