from __future__ import annotations

import os

from carecontact.hosting.readable import readable


def test_what_has_something_to_read_or_ended_is_returned() -> None:
    ends = [os.pipe() for _ in range(3)]
    os.write(ends[0][1], b"x")
    os.close(ends[1][1])
    assert readable([read for read, _ in ends]) == [ends[0][0], ends[1][0]]
    assert readable([ends[2][0]], 0.01) == []
    assert readable([], -1.0) == []
    for end in (*(read for read, _ in ends), ends[0][1], ends[2][1]):
        os.close(end)
