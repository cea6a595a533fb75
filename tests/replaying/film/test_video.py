"""Videos as they are decoded, and files that are whole or not there."""

from __future__ import annotations

import sys
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from carecontact.errors import DependencyError
from carecontact.replaying.film.video import comment_of, write_gif, write_mp4
from tests.reports.browser import Browser, found


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
    told = answer["result"]["value"]
    if told == "no H.264":
        pytest.skip("this Chromium was built without H.264")
    assert told == "64x48 0.64"
