from __future__ import annotations

import hashlib

import pytest
from pydantic import ValidationError

from carecontact.contract.trial import TrialSpec
from carecontact.protocols import load_protocol

SPEC = TrialSpec(protocol=load_protocol(), task_id="T3", seed=7, policy="hover")


def test_ids_sort_like_seeds_and_differ_in_task_and_seed() -> None:
    assert SPEC.trial_id == "T3-s007"
    specs = [SPEC.model_copy(update={"seed": s, "task_id": t}) for t in ("T1", "T2") for s in (0, 2, 9, 10, 19, 100)]
    ids = [spec.trial_id for spec in specs]
    assert ids == sorted(ids)
    assert len(set(ids)) == len(ids)


def test_header_round_trip_keeps_the_protocols_hash() -> None:
    back = TrialSpec.model_validate_json(SPEC.model_dump_json())
    assert back == SPEC
    assert back.protocol.sha256 == SPEC.protocol.sha256


def test_a_noise_salt_is_spelt() -> None:
    salted = SPEC.model_copy(update={"noise_salt": "ab"})
    assert TrialSpec.model_validate_json(salted.model_dump_json()).noise_salt == "ab"


def test_a_sealed_trial_names_the_hash_of_its_salt_and_not_the_salt() -> None:
    salt = "5a" * 32
    salted = SPEC.model_copy(update={"salt": salt})
    assert TrialSpec.model_validate_json(salted.model_dump_json()).salt == salt
    assert salt not in repr(salted)
    assert salt not in salted.sealed.model_dump_json()
    assert salted.sealed.salt_sha256 == hashlib.sha256(salt.encode()).hexdigest() == salted.sealed.commitment
    assert SPEC.sealed == SPEC


def test_policy_arguments_are_spelt() -> None:
    given = {"policy_arguments": {"steps": "3"}, "policy_environment": ("TOKEN",)}
    back = TrialSpec.model_validate_json(SPEC.model_copy(update=given).model_dump_json())
    assert (back.policy_arguments, back.policy_environment) == ({"steps": "3"}, ("TOKEN",))
    assert back != SPEC


def test_a_spec_is_frozen_and_closed() -> None:
    with pytest.raises(ValidationError):
        SPEC.seed = 8
    with pytest.raises(ValidationError, match="angle"):
        TrialSpec.model_validate({**SPEC.model_dump(), "angle": 45})
