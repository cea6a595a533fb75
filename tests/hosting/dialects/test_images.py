"""Pictures as openpi's and RoboArena's clients make them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from carecontact.hosting.dialects.images import cropped_16_9, padded, stretched
from tests.hosting.dialects.given import SIZES, picture

RESIZED = np.load(Path(__file__).parents[2] / "data" / "openpi" / "resized.npz")


@pytest.mark.parametrize(("given", "wanted"), SIZES)
def test_resizing_gives_the_bytes_of_openpis_image_tools(given: tuple[int, int], wanted: tuple[int, int]) -> None:
    expected = RESIZED[f"{given[0]}x{given[1]}-{wanted[0]}x{wanted[1]}"]
    np.testing.assert_array_equal(padded(picture(*given), wanted), expected, strict=True)


def test_a_picture_of_16_9_is_centred_on_black() -> None:
    image = padded(np.full((360, 640, 3), 9, np.uint8), (224, 224))
    assert not image[:49].any()
    assert not image[-49:].any()
    assert (image[49:-49] == 9).all()


@pytest.mark.parametrize(
    ("given", "rows", "columns"),
    [((360, 640), slice(0, 360), slice(0, 640)), ((480, 640), slice(60, 420), slice(0, 640)),
     ((360, 800), slice(0, 360), slice(80, 720))],
)  # fmt: skip
def test_cutting_keeps_the_middle(given: tuple[int, int], rows: slice, columns: slice) -> None:
    image = picture(*given)
    np.testing.assert_array_equal(cropped_16_9(image), image[rows, columns])


def test_roboarena_stretches_with_lanczos_by_way_of_its_captured_size() -> None:
    image = picture(360, 640)
    captured = Image.fromarray(image).resize((512, 288), Image.LANCZOS)
    np.testing.assert_array_equal(stretched(image, None), np.array(captured), strict=True)
    expected = np.array(captured.resize((224, 224), Image.LANCZOS))
    np.testing.assert_array_equal(stretched(image, (224, 224)), expected, strict=True)
    assert np.abs(expected.astype(int) - padded(image, (224, 224))).max() > 100, "the two ways differ"
