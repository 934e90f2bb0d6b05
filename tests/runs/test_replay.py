"""A replay says in words what goes on."""

import base64
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
from PIL import Image
from pydrake.geometry import Box
from pydrake.math import RigidTransform

from feasigrasp.models.control.status import Status, StatusCode
from feasigrasp.runs.replay import start_recording, write_replay
from feasigrasp.systems.monitoring.camera_pictures import Picture, jpeg
from feasigrasp.systems.monitoring.meshcat_view import INVENTED, REACHABLE, SEEN
from tests.browser import visit

HISTORY = (
    Status(0.0, StatusCode.NOTHING_SEEN, "no view of the object yet"),
    Status(1.5, StatusCode.NO_GRASP, 'too "wide" </script><b>'),
)


class Scripts(HTMLParser):
    """Collects the scripts of a page, as a browser delimits them."""

    def __init__(self, page):
        super().__init__()
        self.scripts, self._inside = [], False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self._inside = tag == "script"

    def handle_endtag(self, tag):
        self._inside = False

    def handle_data(self, data):
        if self._inside:
            self.scripts.append(data)


def test_the_page_knows_every_status_whatever_its_words(tmp_path):
    write_replay(start_recording(), tmp_path / "replay.html", HISTORY)
    scripts = Scripts((tmp_path / "replay.html").read_text()).scripts
    (script,) = (text for text in scripts if "const statuses" in text)
    assert entries(script, "statuses") == [
        [0.0, "nothing seen", "no view of the object yet"],
        [1.5, "no grasp", 'too "wide" </script><b>'],
    ]
    assert "setInterval" in script  # it was not cut off


def entries(page: str, name: str) -> list:
    """What a constant of the page's script holds."""
    line = next(line for line in page.splitlines() if f"const {name} =" in line)
    return json.loads(line.split("=", 1)[1].strip().rstrip(";"))


def test_inset_shows_what_the_camera_saw_with_the_object_tinted(tmp_path):
    color = np.full((58, 106, 3), 40, dtype=np.uint8)
    mask = np.zeros((58, 106), dtype=bool)
    mask[10:40, 20:60] = True
    pictures = [Picture(0.25, jpeg(color, mask)), Picture(0.5, jpeg(color, ~mask))]
    write_replay(start_recording(), tmp_path / "replay.html", HISTORY, pictures)
    page = (tmp_path / "replay.html").read_text()
    shown = entries(page, "pictures")
    assert [time for time, _ in shown] == [0.25, 0.5]
    for (_, text), inside in zip(shown, (mask, ~mask), strict=True):
        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(text)))).astype(float)
        red_over_blue = image[..., 0] - image[..., 2]
        assert np.median(red_over_blue[inside]) > 60 > 10 > np.median(red_over_blue[~inside])


def test_legend_has_the_colours_of_what_is_drawn(tmp_path):
    write_replay(start_recording(), tmp_path / "replay.html", HISTORY)
    page = (tmp_path / "replay.html").read_text()
    drawn = {
        "observed surface": SEEN,
        "completed surface": INVENTED,
        "reachable grasps": [REACHABLE.r(), REACHABLE.g(), REACHABLE.b()],
    }
    for word, color in drawn.items():
        (value,) = re.findall(rf'background: #(\w{{6}})"></i>{word}<', page)
        assert np.allclose(list(bytes.fromhex(value)), 255.0 * np.asarray(color), atol=2.0)


def test_without_statuses_there_is_no_line(tmp_path):
    write_replay(start_recording(), tmp_path / "replay.html")
    assert "const statuses" not in (tmp_path / "replay.html").read_text()


#: A page of which no picture is taken has no frames of its own.
FRAMES = """<!DOCTYPE html><script>
  window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 20);
</script>"""
#: What somebody does with the bar; every step notes the bodies' times and what the button offers.
USE = """
<script>
  const wait = (seconds) => new Promise((done) => setTimeout(done, 1e3 * seconds));
  const notes = [];
  const note = async (what) => {
    await wait(0.2);  // the button is set every now and then
    notes.push([what, animator.actions.map((action) => action.time), button.textContent,
      document.getElementById("grasp-status").textContent]);
  };
  const space = () => document.dispatchEvent(new KeyboardEvent("keydown", { key: " " }));
  const scrub = (time) => {
    slider.value = time;
    slider.dispatchEvent(new Event("input"));
  };
  (async () => {
    while (animator.actions.length === 0) await wait(0.05);
    await note("plays");
    scrub(1.8);
    await note("scrubbed");
    await note("stands");
    space();
    while (timeShown() < 2) await wait(0.05);
    await note("rests at the end");
    while (timeShown() >= 1.8) await wait(0.05);
    await note("begins anew");
    button.click();
    await note("paused");
    await note("still");
    document.title = JSON.stringify(notes);
  })();
</script>
"""


def test_bar_plays_pauses_scrubs_and_loops_all_bodies_together(tmp_path):
    """One body moves for 2 s, the other for 1 s, after which it stands until both begin anew."""
    meshcat = start_recording()
    for name, last in (("long", 2.0), ("short", 1.0)):
        meshcat.SetObject(name, Box(0.1, 0.1, 0.1))
        for time in np.linspace(0.0, last, 9):
            meshcat.SetTransform(name, RigidTransform([0.0, 0.0, time]), time)
    page = tmp_path / "replay.html"
    write_replay(meshcat, page, HISTORY)
    page.write_text(FRAMES + page.read_text().replace("</body>", USE + "</body>"))
    notes, _ = visit(page.as_uri(), tmp_path, seconds=20.0)
    times = {what: sorted(at) for what, at, *_ in notes}
    offers = {what: offer for what, _, offer, _ in notes}
    assert times["scrubbed"] == times["stands"] == [1.0, 1.8]
    assert times["rests at the end"] == [1.0, 2.0]
    short, long = times["begins anew"]
    assert short == long < 1.0
    assert times["paused"] == times["still"]
    assert offers == {
        **dict.fromkeys(("plays", "rests at the end", "begins anew"), "pause"),
        **dict.fromkeys(("scrubbed", "stands", "paused", "still"), "play"),
    }
    said = {what: words for what, *_, words in notes}
    assert said["stands"] == '1.8 s: no grasp (too "wide" </script><b>)'
    assert "no view of the object yet" in said["begins anew"]
