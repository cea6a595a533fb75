from __future__ import annotations

import sys

import pytest

from carecontact.cli import main


def test_without_scikit_fem_the_command_says_what_installs_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [n for n in sys.modules if n.split(".")[0] == "skfem" or "validation.fem" in n]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(SystemExit) as exit_:
        raise SystemExit(main(["validate", "--fem"]))
    assert exit_.value.code != 0
    told = capsys.readouterr()
    assert "pip install 'carecontact[fem]'" in told.out + told.err
    assert "Traceback" not in told.out + told.err
