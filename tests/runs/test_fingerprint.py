from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.runs import fingerprint
from carecontact.runs.fingerprint import fingerprint_of, fingerprints


def test_only_what_is_a_file_or_folder_has_one(tmp_path: Path) -> None:
    (tmp_path / "w.pt").write_bytes(b"weights")
    given = {"checkpoint": str(tmp_path / "w.pt"), "folder": str(tmp_path), "steps": "3", "empty": "", "odd": "a\0b"}
    assert set(fingerprints(given)) == {"checkpoint", "folder"}


@pytest.mark.parametrize("whole", [1 << 26, 0], ids=["read whole", "sampled"])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_it_follows_the_content_and_not_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, whole: int
) -> None:
    monkeypatch.setattr(fingerprint, "WHOLE_BYTES", whole)
    monkeypatch.setattr(fingerprint, "SAMPLE_BYTES", 4)
    content, changed = bytes(range(256)) * 4, bytes(range(256)) * 3 + bytes(range(255, -1, -1))
    found = []
    for name, data in (("a", content), ("b", content), ("c", changed), ("d", content[:-1])):
        (tmp_path / name).mkdir()
        (tmp_path / name / "w.pt").write_bytes(data)
        found.append(fingerprint_of(tmp_path / name if kind == "folder" else tmp_path / name / "w.pt"))
    assert found[0] == found[1]
    assert len(set(found)) == 3


def test_a_folder_of_very_many_files_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fingerprint, "MAX_FILES", 2)
    for number in range(3):
        (tmp_path / str(number)).touch()
    assert fingerprint_of(tmp_path) is None
