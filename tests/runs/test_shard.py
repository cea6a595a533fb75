from __future__ import annotations

import pytest

from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.runs.plan import plan_trials, with_noise_salt
from carecontact.runs.shard import Shard

PROTOCOL = load_protocol()
TRIALS = plan_trials(protocol=PROTOCOL, policy="hover", tasks=["T1", "T2"], seeds=range(5))


@pytest.mark.parametrize("count", [1, 3, 4, 7, 10])
def test_the_parts_are_the_whole_in_order_and_of_equal_size(count: int) -> None:
    parts = [Shard(index=k + 1, count=count).of(TRIALS) for k in range(count)]
    assert [spec.trial_id for part in parts for spec in part] == [spec.trial_id for spec in TRIALS]
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "1/0", "a/4", "1/2/3", "-1/4", "1.5/4"])
def test_what_is_no_part_is_refused_with_what_would_be(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--shard .*: expected I/N with I from 1 to N"):
        Shard.parse(text)


def test_more_parts_than_trials_are_refused() -> None:
    assert Shard.parse(" 2 / 4 ") == Shard(index=2, count=4)
    with pytest.raises(ConfigError, match="there are 10 trials; give at most as many parts"):
        Shard(index=1, count=11).of(TRIALS)


def test_the_parts_of_a_run_with_sensor_noise_need_one_salt() -> None:
    noise = PROTOCOL.variation.model_copy(update={"depth_noise": "structured-light-v1"})
    noisy = [TRIALS[0].model_copy(update={"protocol": PROTOCOL.model_copy(update={"variation": noise})})]
    with pytest.raises(ConfigError, match="give every part the same --noise-salt"):
        with_noise_salt(noisy, None, one_of_several=True)
    assert with_noise_salt(noisy, None, one_of_several=False) == noisy
    assert with_noise_salt(noisy, "0a" * 16, one_of_several=True)[0].noise_salt == "0a" * 16
    with pytest.raises(ConfigError, match="expected 32 hexadecimal digits"):
        with_noise_salt(noisy, "xyz", one_of_several=True)
    with pytest.raises(ConfigError, match="no sensor noise"):
        with_noise_salt(TRIALS, "0a" * 16, one_of_several=True)
