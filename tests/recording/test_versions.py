"""Which packages a recording names."""

from __future__ import annotations

from carecontact import __version__
from carecontact.recording.versions import package_versions


def test_versions_name_the_package_that_runs() -> None:
    assert package_versions()["carecontact"] == __version__
