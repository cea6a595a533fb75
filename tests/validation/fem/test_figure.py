from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

from carecontact.validation.fem.cases import CASES
from carecontact.validation.fem.compare import Comparison
from carecontact.validation.fem.figure import draw
from carecontact.validation.fem.materials import SKINS
from tests.validation.fem.made_up import power


def test_every_region_has_a_row_of_panels_and_one_legend_tells_the_lines() -> None:
    done = [
        Comparison(case=case, plain=power(case, 0.6), skins=tuple(power(case, 0.5) for _ in SKINS),
                   simulated=power(case, 0.7), extras={})
        for case in CASES
    ]  # fmt: skip
    figure = Figure(layout="constrained")
    draw(done, figure)
    assert len(figure.axes) == 15
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert told == ["finite elements, all skins", "middle skin", "no skin", "simulator", "people, middle"]
    figure.savefig(BytesIO(), format="png")
