"""Draw the annotated report of docs/reading.md: every heading of a report's page gets a number.

python tools/make_report_picture.py runs/demo/report.html docs/figures/report.jpg

It needs Chromium, as the tests of pages do.
"""

from __future__ import annotations

import io
import itertools
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageChops

WIDTH, HEIGHT, SHOWN_PX = 1100, 3200, 840
BADGE = (
    '<span style="display:inline-block;min-width:1.5em;margin-right:.5em;border-radius:1em;text-align:center;'
    'background:#b3261e;color:#fff;font-weight:700">{}</span>'
)
"""A number before a heading. The page allows styles and no script but its own."""


def picture(report: Path, browser: str = "chromium") -> Image.Image:
    """Return the top of a report as a browser shows it, with its headings numbered and without an empty end."""
    with tempfile.TemporaryDirectory() as folder:
        page, shot = Path(folder) / "page.html", Path(folder) / "page.png"
        number = itertools.count(1)
        text = report.read_text(encoding="utf-8")
        numbered = re.sub(r"<h[12][^>]*>", lambda heading: heading[0] + BADGE.format(next(number)), text)
        page.write_text(numbered, encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        place = [f"--user-data-dir={folder}/profile", f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={shot}"]
        subprocess.run(
            [browser, *options, "--disable-background-networking", *place, page.as_uri()],
            check=True,
            capture_output=True,
        )
        drawn = Image.open(io.BytesIO(shot.read_bytes())).convert("RGB")
    box = ImageChops.difference(drawn, Image.new("RGB", drawn.size, drawn.getpixel((0, 0)))).getbbox()
    assert box is not None, "the page is empty"
    return drawn.crop((0, 0, WIDTH, min(HEIGHT, box[3] + 20)))


def main() -> None:
    report, out = map(Path, sys.argv[1:3])
    drawn = picture(report)
    drawn.resize((SHOWN_PX, round(drawn.height * SHOWN_PX / WIDTH)), Image.Resampling.LANCZOS).save(out, quality=68)


if __name__ == "__main__":
    main()
