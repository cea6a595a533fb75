from __future__ import annotations

import os
import threading

from carecontact.trials.told import ANSWERED, DIGEST_BYTES, POLICY_GONE, POLICY_RUNS, Told


def test_what_is_told_in_any_pieces() -> None:
    read, write = os.pipe()
    told = Told(read)
    told.read()
    assert (told.policy_runs, told.answers) == (False, b"")
    # A digest may hold the bytes that mean something else.
    digests = [POLICY_GONE * DIGEST_BYTES, ANSWERED * DIGEST_BYTES]
    for piece in (POLICY_RUNS, ANSWERED + digests[0][:5], digests[0][5:] + ANSWERED, digests[1]):
        os.write(write, piece)
        told.read()
        assert told.policy_runs
    assert told.answers == b"".join(digests)
    os.write(write, POLICY_GONE)
    told.read()
    assert not told.policy_runs
    os.close(write)
    told.read()
    told.close()


def test_more_answers_than_a_pipe_holds() -> None:
    read, write = os.pipe()
    told, count = Told(read), 5000

    def answer() -> None:
        for k in range(count):
            os.write(write, ANSWERED + k.to_bytes(DIGEST_BYTES))
        os.close(write)

    thread = threading.Thread(target=answer)
    thread.start()
    while thread.is_alive():
        told.read()
    told.read()
    told.close()
    assert len(told.answers) == count * DIGEST_BYTES
