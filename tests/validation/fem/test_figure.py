from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

from carecontact.validation.fem.compare import Comparison
from carecontact.validation.fem.figure import draw
from carecontact.validation.fem.judge import Ground
from carecontact.validation.fem.materials import SKINS
from tests.validation.fem.test_judge import BELLY, power


def test_every_region_has_a_row_of_panels_and_one_legend_tells_the_lines() -> None:
    done = Comparison(
        case=BELLY, ground=Ground(thickness_m=0.05), plain=power(0.6), skins=tuple(power(0.5) for _ in SKINS),
        simulated=power(0.7), extras={},
    )  # fmt: skip
    figure = Figure(layout="constrained")
    draw([done, done], figure)
    assert len(figure.axes) == 8
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert told == ["finite elements, skins", "middle skin", "no skin", "simulator", "people, middle"]
    figure.savefig(BytesIO(), format="png")
