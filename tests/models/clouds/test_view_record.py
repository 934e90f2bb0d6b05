"""When another look at an object tells more."""

import numpy as np
import pytest

from feasigrasp.models.clouds.checks import ViewRecord


def seen_from(*cameras):
    record = ViewRecord()
    for k, camera in enumerate(cameras):
        record = record.extended(camera, float(k))
    return record


def at(angle_deg, distance=0.5):
    angle = np.deg2rad(angle_deg)
    return distance * np.array([np.sin(angle), 0.0, np.cos(angle)])


@pytest.mark.parametrize(
    ("camera", "time", "worth"),
    [
        (at(0.0), 2.0, False),
        (at(9.0), 2.0, False),
        (at(11.0), 2.0, True),
        (at(0.0, 0.7), 2.0, False),  # farther away is no better
        (at(0.0, 0.45), 2.0, False),
        (at(0.0, 0.3), 2.0, True),  # a closer look is
        (at(180.0), 2.0, True),
        (at(0.0), 6.0, True),  # five seconds after the last one
        (at(0.0), 5.9, False),
    ],
)
def test_two_views_of_a_side_suffice_for_a_while(camera, time, worth):
    record = seen_from(at(0.0), at(0.0))
    assert record.adds_information(camera, time, 2, 5.0) is worth


def test_fewer_views_do_not_suffice():
    assert ViewRecord().adds_information(at(0.0), 0.0, 1, 5.0)
    assert seen_from(at(0.0)).adds_information(at(0.0), 0.5, 2, 5.0)
    assert not seen_from(at(0.0)).adds_information(at(0.0), 0.5, 1, 5.0)


def test_views_of_other_sides_do_not_count():
    record = seen_from(at(0.0), at(40.0), at(80.0))
    assert record.adds_information(at(40.0), 3.0, 2, 9.0)
    assert not record.extended(at(42.0), 3.0).adds_information(at(41.0), 3.5, 2, 9.0)


def test_how_far_a_camera_is_from_all_views():
    record = seen_from(at(0.0), at(40.0), at(80.0))
    for angle, expected in ((50.0, 10.0), (100.0, 20.0), (40.0, 0.0)):
        assert np.rad2deg(record.turned(at(angle, 0.7))) == pytest.approx(expected, abs=1e-5)
    assert ViewRecord().turned(at(0.0)) == np.pi


def test_a_record_does_not_change():
    record = seen_from(at(0.0))
    record.extended(at(1.0), 2.0)
    assert record.p_OC.shape == (1, 3)
    with pytest.raises(ValueError, match="read-only"):
        record.p_OC[0, 0] = 1.0
