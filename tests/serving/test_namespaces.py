"""What a policy in namespaces finds in ``/tmp``, wherever it is stored."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import carecontact
from carecontact.interface.policy import PolicyRef
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.fence import available
from carecontact.serving.namespaces import SANDBOX, VARIABLE, granted
from carecontact.serving.process import PolicyProcess, remedy
from tests.serving.conftest import PREAMBLE

needs_namespaces = pytest.mark.skipif(not granted(), reason="this system grants no namespaces")
POLICY = """
import json, tempfile
class P(Base):
    def __init__(self, *, paths: str, writes: str = ""):
        with tempfile.NamedTemporaryFile("w") as file:
            file.write("x")
        if writes:
            open(writes, "w").write("kept")
        print(json.dumps({
            "exist": [os.path.exists(path) for path in paths.split(os.pathsep)], "temporary": tempfile.gettempdir(),
            "read": [open(path).read() for path in paths.split(os.pathsep) if os.path.isfile(path)],
        }))
"""


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder in /tmp, wherever those of other tests are."""
    with tempfile.TemporaryDirectory(dir="/tmp") as made:
        folder = Path(made)
        (folder / "mine").mkdir()
        (folder / "mine" / "stored.py").write_text(PREAMBLE + POLICY)
        (folder / "data").write_text("data")
        (folder / "secret").write_text("secret")
        yield folder


def seen_by_policy(search_path: Path, paths: Sequence[Path], **given: Any) -> dict[str, Any]:
    arguments = {"paths": os.pathsep.join(map(str, paths)), **given.pop("arguments", {})}
    setup = PolicySetup(ref=PolicyRef.parse("stored:P"), search_path=(str(search_path),), arguments=arguments, **given)
    with PolicyProcess(setup, first_deadline_s=60, deadline_s=60) as process:
        process.start()
        process.close()
        return json.loads(process.printed)


@needs_namespaces
def test_what_is_named_lies_where_it_was_and_the_rest_is_hidden(folder: Path) -> None:
    (folder / "link").symlink_to(folder / "mine")
    (folder / "mine" / "runs").mkdir()
    (folder / "mine" / "runs" / "T1-s000.h5").write_text("seed 3")
    found = seen_by_policy(
        folder / "link",
        [folder / "link" / "stored.py", folder / "data"],
        readable=(str(folder / "mine"),),
        writable=(str(folder / "mine"),),
        arguments={"writes": str(folder / "mine" / "left")},
    )
    assert found["exist"] == [True, True]
    assert found["read"][1] == "data"
    assert (folder / "mine" / "left").read_text() == "kept"
    hidden = seen_by_policy(folder / "mine", [folder / "secret" / ".."])
    assert hidden["exist"] == [False], "a folder above what is bound back lists nothing else"
    assert not Path(found["temporary"]).exists(), "it was the policy's own"


@needs_namespaces
def test_a_policy_stored_in_tmp_itself_finds_its_modules(tmp_path: Path) -> None:
    module = Path("/tmp/stored.py")
    if module.exists():
        pytest.skip("somebody has a file of this name")
    module.write_text(PREAMBLE + POLICY)
    try:
        found = seen_by_policy(Path("/tmp"), [module])
    finally:
        module.unlink()
    assert found["exist"] == [True]
    assert found["temporary"] == "/dev/shm"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root has a privilege to give up")
def test_a_process_that_may_not_make_them_runs_policies_without() -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from carecontact.system import drop_capabilities; drop_capabilities()\n"
        "from carecontact.serving.fence import available; print(available())"
    )
    root = str(Path(carecontact.__file__).parents[1])
    text = subprocess.run([sys.executable, "-c", code, root], capture_output=True, text=True, check=True).stdout
    assert "namespaces and Landlock" not in text
    assert "without namespaces" in text or "neither namespaces" in text


def test_another_sandbox_starts_the_policy_and_is_recorded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SANDBOX, "env IN_A_SANDBOX=yes")
    (folder / "mine" / "stored.py").write_text(
        PREAMBLE + "class P(Base):\n    def __init__(self): print(os.environ['IN_A_SANDBOX'])\n"
    )
    setup = PolicySetup(
        ref=PolicyRef.parse("stored:P"), search_path=(str(folder / "mine"),), readable=(str(folder / "data"),)
    )
    with PolicyProcess(setup, first_deadline_s=60, deadline_s=60) as process:
        process.start()
        process.close()
        assert process.printed == "yes"
        assert process.isolation == f"{available()}, in env IN_A_SANDBOX=yes; --policy-read {folder / 'data'}"


def test_the_variable_runs_policies_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "off")
    assert not granted()


@pytest.mark.parametrize(
    "text",
    [
        "PermissionError: [Errno 13] Permission denied: '{}'",
        "cannot be recorded in {}: Permission denied",
        "FileNotFoundError: [Errno 2] No such file or directory: '{}'",
    ],
)
def test_a_closed_file_is_named_with_the_option_that_opens_it(tmp_path: Path, text: str) -> None:
    (tmp_path / "weights").touch()
    message = text.format(tmp_path / "weights")
    assert f"--policy-read {tmp_path}/weights" in remedy(message, isolation="full")
    assert remedy(message, isolation="none: switched off") == remedy(message, isolation=None) == ""


def test_an_unreadable_path_and_an_error_without_one_have_no_remedy(tmp_path: Path) -> None:
    denied = f"Permission denied: '{tmp_path}/no/such/folder'"
    missing = f"No such file or directory: '{tmp_path}/weights'"
    assert remedy(missing, isolation="full") == ""
    assert remedy(denied, isolation="full") == remedy("ValueError: no", isolation="full") == ""
