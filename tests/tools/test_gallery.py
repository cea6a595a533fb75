from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tools import gallery


def test_a_column_for_each_seed_and_a_row_of_arms(tmp_path: Path) -> None:
    out = tmp_path / "new" / "people.png"
    gallery.main(["--protocol", "bathing-v3-draft", "--seeds", "3,18", "--out", str(out)])
    picture = cv2.imread(str(out))
    assert picture is not None
    row = gallery.LABEL + gallery.HEIGHT
    assert picture.shape == (2 * row, 2 * gallery.WIDTH, 3)
    tiles = picture.reshape(2, row, 2, gallery.WIDTH, 3).swapaxes(1, 2)[:, :, gallery.LABEL :]
    # The arm lies elsewhere in both views, and the empty floor at the right of the overhead picture is cut off.
    assert (np.abs(np.diff(tiles.astype(int), axis=1)).max(-1) > 40).mean((1, 2, 3)).min() > 0.01
    sheet = (tiles[0, :, :, gallery.WIDTH * 2 // 3 :] > 220).all(-1).mean((1, 2))
    assert sheet.min() > 0.3
