"""The room of a page in a browser: it draws, turns, is picked, is printed, and reads without WebGL."""

import re

import pytest

from rtcal.report import document, pages
from tests.browser import chromium
from tests.report.pages import no_figure
from tests.report.rooms import calibrated

pytestmark = pytest.mark.long

WEBGL = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--virtual-time-budget=4000")


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    result = calibrated(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(document, "source", no_figure)
        (folder / "page.html").write_text(pages.page(result), encoding="utf-8")
    return folder / "page.html"


def dom(html, at="", *options):
    seen = chromium(html.parent, html.as_uri() + at, *(options or WEBGL), "--dump-dom")
    complaints = [line for line in seen.stderr.splitlines() if "CONSOLE" in line]
    assert [c for c in complaints if "GL Driver Message" not in c] == []  # slow in software
    return seen.stdout


def test_it_turns_to_the_address_and_chooses_a_surface(html):
    plain = dom(html)
    assert 'id="room-of-page" data-drawn="' in plain
    assert 'class="room turned"' in plain
    turned = dom(html, "#turn=90&tilt=-45&part=1&quantity=1&column=2")
    assert 'data-drawn="1.571 -0.785 1"' in turned
    said = re.findall(r'<output id="room-said" aria-live="polite">(.*?)</output>', turned)
    assert said[0].startswith("ceiling: Shift of the coefficient in standard deviations")
    assert re.search(r", 500 Hz: \d\.\d$", said[0])
    assert re.search(r'<tr class="chosen"><td><span[^>]*></span><span class="name"><button', turned)


def test_without_webgl_the_still_pictures_and_the_table_are_there(html):
    text = dom(html, "", "--disable-3d-apis", "--virtual-time-budget=4000")
    assert 'class="room turned"' not in text
    assert re.search(r'<div class="room-stage" hidden', text)
    assert text.count("from above and below</figcaption>") == 2


_HANDS = """<body><iframe style="width: 1200px; height: 1400px" src="page.html#tilt=-60"></iframe>
<script>
const wait = ms => new Promise(done => setTimeout(done, ms));
document.querySelector("iframe").onload = async event => {
  const inside = event.target.contentDocument, canvas = inside.querySelector("canvas");
  const view = event.target.contentWindow, box = canvas.getBoundingClientRect();
  const said = () => inside.getElementById("room-said").textContent;
  const state = () => inside.getElementById("room-of-page").dataset.drawn;
  const told = [];
  const point = (kind, x, y) => canvas.dispatchEvent(new view.PointerEvent(kind, {
    clientX: box.left + x * box.width, clientY: box.top + y * box.height,
    pointerId: 1, bubbles: true }));
  canvas.setPointerCapture = () => {};
  point("pointermove", 0.5, 0.5); told.push("hover " + said());
  point("pointerdown", 0.5, 0.5); point("pointerup", 0.5, 0.5); told.push("click " + state());
  point("pointermove", 0.01, 0.01); told.push("outside " + said());
  point("pointerdown", 0.5, 0.5); point("pointermove", 0.6, 0.5); point("pointerup", 0.6, 0.5);
  told.push("drag " + state());
  for (const key of ["ArrowLeft", "n", "+", "Escape"]) {
    canvas.dispatchEvent(new view.KeyboardEvent("keydown", { key, bubbles: true }));
    told.push(key + " " + state());
  }
  inside.querySelector("#room-parts button").click();
  told.push("row " + state()); told.push("said " + said());
  const list = inside.querySelector("#room-quantity");
  list.value = 1; list.onchange(); told.push("other " + said());
  document.body.append("told: " + told.join("|") + " end");
};</script>"""


def test_pointer_keys_and_rows_choose_and_turn(html):
    frame = html.parent / "hands.html"
    frame.write_text(_HANDS)
    options = (*WEBGL, "--allow-file-access-from-files", "--dump-dom")
    seen = (
        chromium(html.parent, frame, *options).stdout.rpartition("told: ")[2].partition(" end")[0]
    )
    told = dict(step.partition(" ")[::2] for step in seen.split("|"))
    assert told["hover"].startswith("ceiling: ")
    assert told["outside"] == ""
    # The caption of the chosen surface stayed that of the quantity before.
    assert told["said"].partition(": ")[0] == told["other"].partition(": ")[0]
    assert told["said"] != told["other"]
    ends = {
        name: tuple(map(float, value.split()))
        for name, value in told.items()
        if name not in ("hover", "outside", "said", "other")
    }
    turn, tilt, part = ends["click"]
    assert part == 1
    assert ends["drag"][0] < turn - 0.1
    assert ends["drag"][1:] == (tilt, part)
    assert ends["ArrowLeft"][0] == pytest.approx(ends["drag"][0] + 0.1, abs=2e-3)
    assert ends["n"][2] == 2
    assert ends["+"][2] == 2
    assert ends["Escape"][2] == -1
    assert ends["row"][2] == 0
