"""Videos as they are decoded, and files that are whole or not there."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import av
import mujoco
import numpy as np
import pytest
from PIL import Image

from carecontact.errors import DependencyError
from carecontact.interface.robot import PANDA
from carecontact.recording import Recording
from carecontact.replay.film import INSET_HZ, Film, comment_of, write_gif, write_mp4
from carecontact.replay.panel import MARGIN, WIDTH, Panel, story_of
from carecontact.replay.replay import STATE, Replay
from carecontact.replay.stage import LINE_M, FilmSkin, SkinGrid, View, film_scene
from carecontact.sim.state import skin_in_world
from carecontact.world.scene import Scene
from tests.report.browser import Browser, found


def pictures(count: int) -> list[np.ndarray]:
    """A bright bar that moves to the right."""
    out = np.full((count, 48, 64, 3), 20, np.uint8)
    for k in range(count):
        out[k, :, 6 * k : 6 * k + 8] = 230
    return list(out)


def test_a_video_is_decoded_as_it_was_made(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    write_mp4(path, pictures(8), fps=12.5, comment="made of this")
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(stream)]
        assert (stream.codec_context.name, float(stream.average_rate or 0)) == ("h264", 12.5)
        assert stream.codec_context.pix_fmt == "yuv420p", "what browsers play"
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 8
    bars = [int(frame[24, :, 1].astype(int).argmax()) for frame in frames]
    assert np.allclose(bars, 6 * np.arange(8), atol=8)
    assert comment_of(path) == "made of this"


def test_a_video_that_was_interrupted_leaves_nothing(tmp_path: Path) -> None:
    def broken():  # type: ignore[no-untyped-def]
        yield pictures(1)[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_mp4(tmp_path / "a.mp4", broken(), fps=10, comment="")
    assert list(tmp_path.iterdir()) == []


def test_no_video_has_no_comment(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"not a video")
    assert comment_of(tmp_path / "a.mp4") is None
    assert comment_of(tmp_path / "none.mp4") is None


def test_without_the_extra_the_error_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(DependencyError, match=r"pip install 'carecontact\[viz\]'"):
        write_mp4(tmp_path / "a.mp4", pictures(1), fps=10, comment="")


def test_an_animation_has_every_picture(tmp_path: Path) -> None:
    write_gif(tmp_path / "a.gif", pictures(8), fps=12.5)
    with Image.open(tmp_path / "a.gif") as animation:
        assert (animation.n_frames, animation.size, animation.info["duration"]) == (8, (64, 48), 80)
        animation.seek(5)
        bright = np.asarray(animation.convert("L"))[24] > 128
    assert np.flatnonzero(bright).tolist() == list(range(30, 38))


def test_a_browser_plays_the_video(tmp_path: Path) -> None:
    program = found()
    if program is None:
        pytest.skip("no Chromium on this machine")
    write_mp4(tmp_path / "a.mp4", pictures(8), fps=12.5, comment="")
    (tmp_path / "page.html").write_text('<video src="a.mp4" preload="auto" muted></video>')
    played = """
    new Promise(resolve => {
      const video = document.querySelector("video");
      if (!video.canPlayType('video/mp4; codecs="avc1.640020"')) resolve("no H.264");
      video.onerror = () => resolve("error " + video.error.code);
      const tell = () => resolve(`${video.videoWidth}x${video.videoHeight} ${video.duration.toFixed(2)}`);
      if (video.readyState >= 2) tell(); else video.onloadeddata = tell;
      video.load();
    })
    """
    with Browser(program, tmp_path / "profile") as browser:
        answer = browser.open(tmp_path / "page.html").call(
            "Runtime.evaluate", expression=played, returnByValue=True, awaitPromise=True
        )
    wording = answer["result"]["value"]
    if wording == "no H.264":
        pytest.skip("this Chromium was built without H.264")
    assert wording == "64x48 0.64"


# Several processes that draw one video.

SMALL = (160, 90)


@pytest.mark.slow
def test_the_pictures_do_not_depend_on_the_number_of_processes(pressed: Recording) -> None:
    one, two = (list(Film(pressed, fps=4, size=SMALL, panel=False).frames(1.9, 2.8, jobs=jobs)) for jobs in (1, 2))
    assert len(one) == len(two) > 2
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
    assert any((a != one[0]).any() for a in one), "the pictures differ, so that their order shows"

    bare = Film(pressed, fps=4, size=SMALL, panel=False, shadows=False).frames(1.9, 2.8)
    assert (next(bare).astype(int) - one[0]).max() > 30, "without shadows, some places are brighter"


def test_a_batch_has_one_small_picture_of_the_room(pressed: Recording) -> None:
    film = Film(pressed, fps=50, size=SMALL)
    batches = list(film._batches(0.0, np.inf))
    assert sum(map(len, batches)) == film.count
    assert max(batch[-1].time_s - batch[0].time_s for batch in batches) < 1 / INSET_HZ
    assert max(map(len, batches)) > 5


class Killed:
    def __call__(self, time_s: float) -> View:
        os._exit(9)


def test_a_drawing_process_that_is_killed_is_reported(pressed: Recording) -> None:
    film = Film(pressed, fps=4, size=SMALL, panel=False)
    film.view = Killed()
    with pytest.raises(DependencyError, match=r"was killed.*--jobs 1"):
        list(film.frames(jobs=2))


# The drawn skin follows the shell, stays out of the tool and has no seam.

World = tuple[Scene, FilmSkin, mujoco.MjData]


@pytest.fixture(scope="module")
def world(pressed: Recording) -> World:
    """At the last shown state, pressed."""
    replay = Replay(pressed)
    scene = film_scene(replay.scene, "forearm")
    data = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, data, list(replay.stretches(10.0))[-1].states[-1], STATE)
    mujoco.mj_kinematics(scene.model, data)
    return scene, FilmSkin(scene), data


def test_the_skin_gives_way_under_the_tool_and_nowhere_else(world: World, pressed: Recording) -> None:
    scene, skin, data = world
    rest = skin_in_world(scene.model, data)
    vertices, _ = skin.placed(data)
    moved = np.linalg.norm(vertices - rest, axis=1)
    depth = float(pressed["scorer/indentation_m"][-1].max())
    assert depth > 0.004
    assert 0.7 * depth < moved.max() < 1.6 * depth
    far = np.linalg.norm(rest - data.site(PANDA.tcp_site).xpos, axis=1) > 0.08
    assert moved[far].max() < 5e-4
    assert not moved[~skin.dentable].any()


def test_no_skin_is_inside_the_tool(world: World) -> None:
    _, skin, data = world
    vertices, _ = skin.placed(data)
    tip = data.geom(PANDA.tip.geom)
    local = (vertices - tip.xpos) @ tip.xmat.reshape(3, 3) / np.array(PANDA.tip.half_m)
    assert np.linalg.norm(local, axis=1).min() > 1


def test_vertices_at_one_place_have_one_normal(world: World) -> None:
    scene, skin, data = world
    _, normals = skin.placed(data)
    bind = np.asarray(scene.model.skin_vert).reshape(-1, 3)
    order = np.lexsort(bind.T)
    same = (bind[order][1:] == bind[order][:-1]).all(1)
    assert same.any(), "seams of the texture split vertices"
    assert np.allclose(normals[order][1:][same], normals[order][:-1][same])
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)


def test_lines_are_where_the_region_has_whole_steps(world: World) -> None:
    scene, _, _ = world
    grid, frame = SkinGrid(scene, "forearm"), scene.frames["forearm"]
    bind = np.asarray(scene.model.skin_vert, np.float64).reshape(-1, 3)
    ends = bind[grid._pairs]
    points = ends[..., 0, :] + grid._shares[..., None] * (ends[..., 1, :] - ends[..., 0, :])
    local = ((points.reshape(-1, 3) - frame.origin) @ frame.axes)[:, :2] / LINE_M
    assert len(local) > 1000
    assert np.abs(local - np.round(local)).min(1).max() < 1e-6


# What a film tells, against the recording that it is of.


def test_events_are_where_the_recording_has_them(pressed: Recording) -> None:
    story = story_of(pressed)
    assert [event.text.split()[0] for event in story.events] == ["start", "first", "peak", "gate", "done"]
    force = np.linalg.norm(pressed["scorer/force_human_from_robot_in_world"], axis=2).max(1)
    touched = pressed["scorer/time_s"][force > 0.2]
    assert abs(story.events[1].time_s - touched[0]) < 0.1
    assert story.events[-1].time_s == story.duration_s
    assert story.trace.peak_n is not None
    assert f"peak force, {story.trace.peak_n:.1f} N on the right forearm" in [event.text for event in story.events]


def test_the_map_has_the_pressure_that_the_cells_felt(pressed: Recording) -> None:
    cells = story_of(pressed).map
    assert cells is not None
    end = float(pressed["scorer/period_time_s"][-1])
    pressure, touched = cells.at(end)
    felt = 1000 * pressure @ pressed["scorer/cell_area_m2"]
    column = pressed.header.segments.index("right_forearm")
    last = pressed["scorer/time_s"] > pressed["scorer/period_time_s"][-2] - 1e-9
    assert np.isclose(felt, pressed["scorer/normal_force"][last, column].mean(), rtol=0.02)
    assert (touched >= (pressure > 0)).all()
    before, nothing = cells.at(0.5)
    assert not before.any()
    assert not nothing.any()


def test_the_heading_names_the_level_of_the_protocol(pressed: Recording) -> None:
    header = pressed.header
    protocol = header.spec.protocol.model_copy(update={"level": "L3"})
    levelled = replace(
        pressed, header=header.model_copy(update={"spec": header.spec.model_copy(update={"protocol": protocol})})
    )
    assert story_of(levelled).about.endswith(f"{protocol.id} L3")


def test_a_long_subtitle_stays_inside_the_frame(pressed: Recording) -> None:
    story = story_of(pressed)
    bare = Panel(replace(story, about=""), note="").at(0.0)
    words = " ".join(["person.alive.breathing.abdomen_m=[0.015, 0.015]"] * 6)
    long = Panel(replace(story, about=words), note="").at(0.0)
    written = np.flatnonzero((long != bare).any(axis=(0, 2)))
    assert MARGIN - 2 <= written.min()
    assert written.max() < WIDTH - MARGIN / 2, "the ellipsis may stand in the margin"
