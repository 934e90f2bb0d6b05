"""A replay says in words what goes on."""

import json
from html.parser import HTMLParser

from feasigrasp.evaluation.runs.replay import start_recording, write_replay
from feasigrasp.models.control.status import Status, StatusCode

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
    line = next(line for line in script.splitlines() if "const statuses" in line)
    entries = json.loads(line.split("=", 1)[1].strip().rstrip(";"))
    assert entries == [
        [0.0, "nothing seen", "no view of the object yet"],
        [1.5, "no grasp", 'too "wide" </script><b>'],
    ]
    assert "setInterval" in script  # it was not cut off


def test_without_statuses_there_is_no_line(tmp_path):
    write_replay(start_recording(), tmp_path / "replay.html")
    assert "const statuses" not in (tmp_path / "replay.html").read_text()
