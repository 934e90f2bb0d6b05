"""``feasigrasp evaluate followable``."""

import json

from feasigrasp.cli import main


def test_quicker_objects_leave_fewer_hand_poses(tmp_path):
    few = ["--quick", "--hands", "10", "--moments", "8"]
    assert main(["evaluate", "followable", *few, "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "summary.json").read_text())["rows"]
    share = {row["preset"]: row["value"] for row in rows}
    assert len(share) == 30
    assert all(share[f"{point}/safe"] <= share[point] for point in list(share)[::2])
    assert share["circle/0.45/safe"] < share["circle/0.45"]
    assert 0.0 <= share["circle/0.6"] < share["circle/0.3"] <= share["circle/0.05"] < 100.0


def test_the_longer_they_keep_up_the_fewer(tmp_path):
    shares = []
    for name, time in (("short", "0.2"), ("long", "1.2")):
        few = ["--quick", "--hands", "10", "--moments", "8", "--time", time]
        assert main(["evaluate", "followable", *few, "--out", str(tmp_path / name)]) == 0
        rows = json.loads((tmp_path / name / "summary.json").read_text())["rows"]
        shares.append({row["preset"]: row["value"] for row in rows})
    assert all(shares[0][point] >= shares[1][point] for point in shares[0])
    assert shares[0]["circle/0.6"] > shares[1]["circle/0.6"]
