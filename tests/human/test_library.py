"""A user's SMPL-X file, played by one with its keys and a shipped body's geometry; the real one may not be shipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import ConfigError
from carecontact.human.body import PARENT, Body
from carecontact.human.joints import hinges
from carecontact.human.library import DENSITY_KG_M3, JOINTS, SEGMENT_JOINTS, SUPINATION_DEG, load_body
from carecontact.human.skin import texture_of
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import build_scene
from tests.human.smplx_file import smplx_arrays, write_smplx

MODEL = "woman-old-heavy"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_smplx(tmp_path_factory.mktemp("smplx") / "SMPLX_FEMALE.npz")


@pytest.fixture(scope="module")
def smplx(file: Path) -> Body:
    return load_body(f"smplx:{file}?sex=F&age=old")


def test_the_55_joints_are_each_in_one_segment() -> None:
    assert len(JOINTS) == len(set(JOINTS)) == 55
    assert sorted(j for own in SEGMENT_JOINTS.values() for j in own) == sorted(JOINTS)
    assert set(SEGMENT_JOINTS) == set(PARENT)


def test_it_is_the_person_in_the_file(smplx: Body) -> None:
    like = load_body(MODEL)
    assert (smplx.sex, smplx.age_group, smplx.name[:6]) == ("F", "old", "smplx:")
    assert smplx.stature_m == pytest.approx(like.stature_m, abs=0.01)
    assert smplx.mass_kg == pytest.approx(like.mass_kg, rel=0.03)
    for segment in ("pelvis", "neck", "head", "left_thigh", "right_shank", "right_foot"):
        np.testing.assert_allclose(smplx.joint_centre[segment], like.joint_centre[segment], atol=1e-6)
    np.testing.assert_allclose(smplx.weight.sum(1), 1)


def test_arms_of_the_t_pose_get_their_anatomical_angles(smplx: Body) -> None:
    rows = {row.name: row for row in hinges(smplx)}
    for side in ("left", "right"):
        assert rows[f"{side}_upper_arm_abduction"].bind_deg == pytest.approx(90, abs=1)
        assert rows[f"{side}_forearm_flexion"].bind_deg == pytest.approx(0, abs=1)
        assert rows[f"{side}_forearm_supination"].bind_deg == pytest.approx(SUPINATION_DEG, abs=0.5)


def test_it_settles_like_a_shipped_body(smplx: Body) -> None:
    protocol = overridden(load_protocol("bathing-v3"), {"person.body": smplx.name})
    simulation = Simulation(build_scene(protocol, target=None, skin=False))
    settled = simulation.settle(52.5)
    assert settled.comfort_arm_deg == pytest.approx(52.5, abs=1)
    q, (low, high) = settled.joint_position, simulation.joint_range.T
    assert np.degrees(np.minimum(q - low, high - q)).min() >= 5


def test_skin_is_painted_with_and_without_texture_coordinates(smplx: Body, tmp_path: Path) -> None:
    path = tmp_path / "with_uv.npz"
    np.savez(path, **smplx_arrays(MODEL, texture=True))
    with_uv = load_body(f"smplx:{path}?sex=F&age=old")
    np.testing.assert_allclose(with_uv.uv, load_body(MODEL).uv)
    for body in (smplx, with_uv):
        assert body.uv.min() >= 0
        assert body.uv.max() <= 1
    assert len(np.unique(texture_of(smplx).reshape(-1, 3), axis=0)) > 1000


def test_mass_age_and_shape_are_options(file: Path, smplx: Body) -> None:
    young = load_body(f"smplx:{file}?sex=M&mass=70&betas=1")
    assert (young.sex, young.age_group, young.mass_kg) == ("M", "adult", 70.0)
    # The file's first shape direction makes everything 1 % larger.
    assert young.stature_m == pytest.approx(1.01 * smplx.stature_m, rel=1e-6)
    bigger = load_body(f"smplx:{file}?sex=F&betas=1")
    assert bigger.mass_kg == pytest.approx(1.01**3 * smplx.mass_kg, rel=0.01)
    assert smplx.mass_kg < DENSITY_KG_M3 * 0.1


@pytest.mark.parametrize(
    ("query", "fault"),
    [
        ("", r"\?sex=F or \?sex=M"),
        ("?sex=X", r"\?sex=F or \?sex=M"),
        ("?sex=F&age=child", "neither adult nor old"),
        ("?sex=F&height=2", "no option height"),
        ("?sex=F&betas=a", "could not convert"),
        ("?sex=F&mass=5000", "20 to 300"),
        ("?sex=F&betas=1,2,3", "3 betas, but shapedirs has 2"),
        ("?sex=F&mass=nan", "20 to 300"),
    ],
)
def test_wrong_options_are_named(file: Path, query: str, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        load_body(f"smplx:{file}{query}")


WRONG = {
    "weights": (None, "lacks weights; an SMPL-X npz has v_template"),
    "v_template": (np.zeros((10, 2)), r"v_template has shape \(10, 2\), expected \(10, 3\)"),
    "J_regressor": (np.zeros((24, 13710)), "J_regressor has shape .* for the 55 joints"),
    "kintree_table": (np.zeros((2, 55), np.int64), "kintree_table .*left_shoulder .*left_elbow"),
    "f": (np.array([[0, 1, 10**6]]), "f must name vertices 0 to"),
}


@pytest.mark.parametrize("key", sorted(WRONG))
def test_wrong_arrays_are_named(tmp_path: Path, key: str) -> None:
    changed, fault = WRONG[key]
    path = write_smplx(tmp_path / "bad.npz", **{key: changed})
    with pytest.raises(ConfigError, match=fault):
        load_body(f"smplx:{path}?sex=F")


def test_nan_and_millimetres_are_named(tmp_path: Path) -> None:
    vertices = smplx_arrays()["v_template"]
    with pytest.raises(ConfigError, match=r"m\^3.*metres"):
        load_body(f"smplx:{write_smplx(tmp_path / 'mm.npz', v_template=1000 * vertices)}?sex=F")
    vertices[3] = np.nan
    with pytest.raises(ConfigError, match="v_template holds something other than finite numbers"):
        load_body(f"smplx:{write_smplx(tmp_path / 'nan.npz', v_template=vertices)}?sex=F")


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_what_is_no_npz_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "SMPLX_MALE.npz"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"SMPLX_MALE\.npz: .*npz archive"):
        load_body(f"smplx:{path}?sex=M")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_body(f"smplx:{tmp_path / 'none.npz'}")
