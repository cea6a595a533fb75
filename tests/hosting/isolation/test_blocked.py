from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.hosting.isolation.blocked import remedy


@pytest.mark.parametrize(
    "said",
    [
        "PermissionError: [Errno 13] Permission denied: '{}'",
        "cannot be recorded in {}: Permission denied",
        "FileNotFoundError: [Errno 2] No such file or directory: '{}'",
    ],
)
def test_a_closed_file_is_named_with_the_option_that_opens_it(tmp_path: Path, said: str) -> None:
    (tmp_path / "weights").touch()
    message = said.format(tmp_path / "weights")
    assert f"--policy-read {tmp_path}/weights" in remedy(message, isolation="full")
    assert remedy(message, isolation="none: switched off") == remedy(message, isolation=None) == ""


def test_what_nobody_can_read_or_is_no_matter_of_files_has_no_remedy(tmp_path: Path) -> None:
    denied = f"Permission denied: '{tmp_path}/no/such/folder'"
    missing = f"No such file or directory: '{tmp_path}/weights'"
    assert remedy(missing, isolation="full") == ""
    assert remedy(denied, isolation="full") == remedy("ValueError: no", isolation="full") == ""
