"""Shells kept on disk."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.cache_folder import CACHE_VARIABLE
from carecontact.protocols import load_protocol
from carecontact.world.human.library import load_body
from carecontact.world.human.shell import Shell, kept_shell
from carecontact.world.scene import region_shell

PROTOCOL = load_protocol()
BODY, TISSUE = load_body(PROTOCOL.person.body), PROTOCOL.person.tissue["forearm"]


def forbidden() -> Shell:
    raise AssertionError("computed again")


def test_a_kept_shell_has_the_same_bits_and_belongs_to_one_body_region_and_tissue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    shell = region_shell(BODY, "forearm", TISSUE)
    kept_shell(BODY, "forearm", TISSUE, lambda: shell)
    again = kept_shell(BODY, "forearm", TISSUE, forbidden)
    for field in fields(Shell):
        value = getattr(again, field.name)
        assert type(value) is type(getattr(shell, field.name))
        np.testing.assert_array_equal(value, getattr(shell, field.name))
    coarse = TISSUE.model_copy(update={"spacing_m": 2 * TISSUE.spacing_m})
    for other in (
        (replace(BODY, name="other"), "forearm", TISSUE),
        (BODY, "upper_arm", TISSUE),
        (BODY, "forearm", coarse),
    ):
        with pytest.raises(AssertionError, match="computed again"):
            kept_shell(*other, forbidden)
