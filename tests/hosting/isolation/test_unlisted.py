from __future__ import annotations

from pathlib import Path

from carecontact.hosting.isolation.unlisted import UnlistedFolders


def test_modules_packages_and_folders_are_found_by_name(tmp_path: Path) -> None:
    (tmp_path / "module.py").touch()
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__init__.py").touch()
    (tmp_path / "space").mkdir()
    finder = UnlistedFolders([str(tmp_path / "empty"), str(tmp_path)])
    module, package, space = (finder.find_spec(name, None) for name in ("module", "package", "space"))
    assert module is not None
    assert module.origin == str(tmp_path / "module.py")
    assert package is not None
    assert list(package.submodule_search_locations or ()) == [str(tmp_path / "package")]
    assert space is not None
    assert list(space.submodule_search_locations or ()) == [str(tmp_path / "space")]
    assert finder.find_spec("absent", None) is None
    assert finder.find_spec("module", [str(tmp_path)]) is None, "in a package the usual finder looks"
