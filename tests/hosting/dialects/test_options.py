from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.hosting.setup import PolicySetup


@pytest.mark.parametrize(
    ("address", "says"),
    [
        (
            "openpi://gpu:8000?profile=pi05-droit",
            r"no profile named 'pi05-droit' \(did you mean 'pi05-droid'\?\); valid: pi05-droid, pi05-droid-jointpos",
        ),
        ("vla-eval://gpu:8000?space=joint", r"no action space 'joint' in this dialect.*valid: droid_joint_vel"),
    ],
)  # fmt: skip
def test_a_name_that_nobody_knows_is_refused_before_anything_is_connected(address: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        PolicySetup.of(address)
    assert address in str(caught.value)


def test_known_names_pass() -> None:
    for address in ("openpi://gpu:8000?profile=pi05-droid", "vla-eval://gpu:8000?space=joint_position"):
        assert PolicySetup.of(address).ref.text == address
