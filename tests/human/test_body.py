from __future__ import annotations

import json
import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import AssetError, UnknownNameError
from carecontact.human import library
from carecontact.human.body import DE_LEVA, PARENT, Body, segment_ends, segment_inertias
from carecontact.human.library import body_names, load_body
from carecontact.human.skin import baked_texture
from carecontact.recording.schema import SEGMENTS

MIRROR = np.array([-1.0, 1.0, 1.0])


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of the bodies that ``load_body`` reads, free to be damaged."""
    source = resources.files("carecontact") / "assets" / "bodies"
    with resources.as_file(source) as folder:
        shutil.copytree(folder, tmp_path / "assets" / "bodies")
    monkeypatch.setattr(library.resources, "files", lambda _: tmp_path)
    return tmp_path / "assets" / "bodies"


def test_unknown_body_lists_the_shipped_ones() -> None:
    with pytest.raises(UnknownNameError, match="no body named 'giant'; valid: ") as caught:
        load_body("giant")
    assert set(body_names()) < set(caught.value.valid)
    assert any(name.startswith("smplx:FILE.npz") for name in caught.value.valid)


def test_shipped_bodies_are_man_and_woman_adult_and_old_light_and_heavy() -> None:
    names = {
        f"{who}-{age}-{build}" for who in ("man", "woman") for age in ("adult", "old") for build in ("light", "heavy")
    }
    assert set(body_names()) == {"man-adult", *names}


def test_name_sex_age_and_build_agree(body: Body) -> None:
    who, age, *build = body.name.split("-")
    assert (body.sex, body.age_group) == ("M" if who == "man" else "F", age)
    if build:
        assert body.bmi == pytest.approx({"light": 20.5, "heavy": 32.0}[build[0]], abs=0.15)
    assert 1.5 < body.stature_m < 1.8


def test_archive_is_under_its_limit(body: Body) -> None:
    folder = resources.files("carecontact") / "assets" / "bodies"
    assert len((folder / f"{body.name}.npz").read_bytes()) < 800_000
    assert len((folder / f"{body.name}.skin.png").read_bytes()) < 320_000


def test_a_changed_archive_is_refused(copied: Path) -> None:
    name = body_names()[0]
    data = bytearray((copied / f"{name}.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (copied / f"{name}.npz").write_bytes(data)
    with pytest.raises(AssetError, match=rf"body {name}\.npz has sha256 .* provenance file says"):
        load_body(name)


def test_an_archive_without_its_record_is_refused(copied: Path) -> None:
    name = body_names()[0]
    (copied / f"{name}.provenance.json").unlink()
    with pytest.raises(AssetError, match=rf"{name}.*provenance"):
        load_body(name)


def test_segments_are_the_rigs_and_hold_those_of_the_recording(body: Body) -> None:
    assert set(body.segments) == set(PARENT)
    assert set(SEGMENTS) == {s for s in body.segments if not s.endswith("clavicle")}
    for segment in body.segments:
        parent = PARENT[segment]
        assert parent is None or body.segments.index(parent) < body.segments.index(segment)


def test_weights_sum_to_one_and_every_segment_owns_skin(body: Body) -> None:
    np.testing.assert_allclose(body.weight.sum(1), 1.0, atol=1e-12)
    assert body.weight.min() >= 0
    assert body.weight_segment.max() < len(body.segments)
    assert set(np.unique(body.owner)) == set(range(len(body.segments)))
    assert sum(len(body.vertices_of(s)) for s in body.segments) == len(body.vertices)


def test_faces_fit_vertices_and_texture(body: Body) -> None:
    assert body.faces.shape == body.uv_faces.shape
    assert set(np.unique(body.faces)) == set(range(len(body.vertices)))
    assert body.uv_faces.max() < len(body.uv)
    assert body.uv.min() >= 0
    assert body.uv.max() <= 1


def test_surface_is_wound_outward_and_encloses_the_bodys_volume(body: Body) -> None:
    corner = body.vertices[body.faces]
    volume = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6
    assert volume == pytest.approx(body.meta["measured_by_anny"]["volume"], rel=5e-3)  # the arms were moved after
    # Lean tissue, fat and bone together: 0.95 to 1.1 g/cm^3.
    assert 950 < body.mass_kg / volume < 1100


def test_size_is_that_of_the_record(body: Body) -> None:
    recorded = json.loads(
        (resources.files("carecontact") / "assets" / "bodies" / f"{body.name}.provenance.json").read_text()
    )
    assert np.ptp(body.vertices[:, 2]) == pytest.approx(recorded["parameters"]["stature_m"], abs=0.01)
    assert body.sha256 == recorded["sha256"]
    assert body.sex in "MF"


def test_bind_pose_faces_minus_y_with_the_left_at_plus_x(body: Body) -> None:
    joints = body.joint_centre
    assert joints["left_hand"][0] > joints["left_upper_arm"][0] > 0
    assert joints["head"][2] > joints["thorax"][2] > joints["pelvis"][2] > joints["left_foot"][2]
    assert body.landmarks["eye.L"][0] > 0
    assert body.landmarks["eye.L"][1] < joints["head"][1]
    toes = body.vertices_of("left_foot")[:, 1].min()
    assert toes < joints["left_foot"][1] - 0.1


def test_skeleton_is_symmetric(body: Body) -> None:
    for segment, centre in body.joint_centre.items():
        twin = segment.replace("left", "right") if segment.startswith("left") else segment.replace("right", "left")
        np.testing.assert_allclose(body.joint_centre[twin], centre * MIRROR, atol=2e-3, err_msg=segment)


def test_joint_centres_lie_inside_the_body(body: Body) -> None:
    low, high = body.vertices.min(0), body.vertices.max(0)
    for segment, centre in body.joint_centre.items():
        nearest = np.linalg.norm(body.vertices - centre, axis=1).min()
        assert (centre > low).all(), segment
        assert (centre < high).all(), segment
        assert nearest < 0.13, segment


def test_limb_axes_join_neighbouring_joints(body: Body) -> None:
    for upper, lower in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")):
        end = body.joint_centre[f"right_{upper}"] + body.axis_vector(f"right_{upper}")
        np.testing.assert_allclose(end, body.joint_centre[f"right_{lower}"])
        assert np.linalg.norm(body.direction(f"right_{upper}")) == pytest.approx(1)
    middle_fingertip = body.joint_centre["left_hand"] + body.axis_vector("left_hand")
    # The knuckle line of the last phalanx, 12 to 22 cm from an adult's wrist.
    assert 0.12 < np.linalg.norm(middle_fingertip - body.joint_centre["left_hand"]) < 0.22


def test_faces_of_a_segment_reach_one_ring_beyond_it(body: Body) -> None:
    index = body.segments.index("right_forearm")
    faces = body.faces_of("right_forearm")
    assert (body.owner[faces] == index).any(1).all()
    others = set(map(tuple, body.faces)) - set(map(tuple, faces))
    assert not any((body.owner[list(face)] == index).any() for face in others)


def test_no_file_of_a_body_is_read_alone(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An access time would tell an isolated policy which person the trial before its own had."""
    read: list[str] = []
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.append(path.name) or path.open("rb").read())
    load_body(body_names()[0])
    baked_texture(body_names()[1])
    assert sorted(read) == sorted(path.name for path in copied.iterdir())


PAIRED = {"upper_arm", "forearm", "hand", "thigh", "shank", "foot"}


@pytest.mark.parametrize("sex", ["M", "F"])
def test_published_mass_fractions_sum_to_the_whole(sex: str) -> None:
    total = sum(row.mass * (2 if kind in PAIRED else 1) for kind, row in DE_LEVA[sex].items())
    # The table gives two decimals of a percent.
    assert total == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize(
    ("sex", "segment", "mass", "centre", "gyration"),
    [
        ("M", "forearm", 0.0162, 0.4574, (0.276, 0.265, 0.121)),
        ("F", "forearm", 0.0138, 0.4559, (0.261, 0.257, 0.094)),
        ("M", "upper_arm", 0.0271, 0.5772, (0.285, 0.269, 0.158)),
        ("F", "abdomen", 0.1465, 0.4512, (0.433, 0.354, 0.415)),
        ("M", "shank", 0.0433, 0.4395, (0.251, 0.246, 0.102)),
    ],
)
def test_rows_of_the_table(
    sex: str, segment: str, mass: float, centre: float, gyration: tuple[float, float, float]
) -> None:
    row = DE_LEVA[sex][segment]
    assert (row.mass, row.centre) == pytest.approx((mass, centre))
    assert row.gyration == pytest.approx(gyration)


def test_segment_masses_sum_to_the_bodys(body: Body) -> None:
    inertias = segment_inertias(body)
    assert set(inertias) == set(body.segments)
    assert sum(row.mass_kg for row in inertias.values()) == pytest.approx(body.mass_kg, rel=1e-12)
    assert min(row.mass_kg for row in inertias.values()) > 0.1


def test_shares_of_neck_and_clavicles_come_off_head_and_chest(body: Body) -> None:
    mass = {s: row.mass_kg for s, row in segment_inertias(body).items()}
    table, whole = DE_LEVA[body.sex], body.mass_kg
    assert mass["head"] + mass["neck"] == pytest.approx(table["head"].mass * whole, rel=1e-3)
    chest = mass["thorax"] + mass["left_clavicle"] + mass["right_clavicle"]
    assert chest == pytest.approx(table["thorax"].mass * whole, rel=1e-3)


def test_left_and_right_are_equal(body: Body) -> None:
    inertias = segment_inertias(body)
    for kind in (*PAIRED, "clavicle"):
        left, right = inertias[f"left_{kind}"], inertias[f"right_{kind}"]
        assert left.mass_kg == right.mass_kg
        np.testing.assert_allclose(left.moments_kgm2, right.moments_kgm2, rtol=0.02)
        np.testing.assert_allclose(left.centre_m * [-1, 1, 1], right.centre_m, atol=3e-3)


def test_inertias_are_those_of_real_bodies(body: Body) -> None:
    for segment, row in segment_inertias(body).items():
        np.testing.assert_allclose(row.axes.T @ row.axes, np.eye(3), atol=1e-9, err_msg=segment)
        assert np.linalg.det(row.axes) == pytest.approx(1), segment
        moments = np.sort(row.moments_kgm2)
        assert moments[0] > 0, segment
        assert moments[0] + moments[1] >= moments[2], segment


def test_centre_of_mass_lies_inside_the_segment(body: Body) -> None:
    for segment, row in segment_inertias(body).items():
        if segment.endswith("clavicle") or segment == "neck":
            continue
        first, second = segment_ends(body, segment)
        along = second - first
        share = (row.centre_m - first) @ along / (along @ along)
        assert share == pytest.approx(
            DE_LEVA[body.sex][segment.split("_", 1)[-1] if "_" in segment else segment].centre
        )
        # Longitudinal column along the segment; a limb is hardest to turn about the other two.
        assert abs(row.axes[:, 2] @ along) == pytest.approx(np.linalg.norm(along))
        if segment.split("_", 1)[-1] in PAIRED:
            assert row.moments_kgm2.argmin() == 2, segment


def test_sagittal_axis_points_front_to_back(body: Body) -> None:
    """The first column turns the trunk and a hanging limb forward, the second sideways."""
    inertias = segment_inertias(body)
    for segment in ("thorax", "pelvis", "left_thigh", "right_shank"):
        axes = np.abs(inertias[segment].axes)
        assert axes[0, 0] > 0.9, segment
        assert axes[1, 1] > 0.9, segment


def test_whole_body_centre_of_mass_is_near_the_navel(body: Body) -> None:
    """Standing adults: 53 to 60 % of stature above the soles, and on the mid-line."""
    inertias = segment_inertias(body)
    centre = sum(row.mass_kg * row.centre_m for row in inertias.values()) / body.mass_kg
    height = (centre[2] - body.vertices[:, 2].min()) / np.ptp(body.vertices[:, 2])
    assert 0.53 < height < 0.60
    assert abs(centre[0]) < 2e-3
