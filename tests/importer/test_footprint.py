import numpy as np
import pytest

from kinfeas.importer.arm import find_arm, place
from kinfeas.importer.boxed import on_the_floor
from kinfeas.robots.urdf import parse_urdf


def stand(path, tmp_path):
    arm = find_arm(parse_urdf(path), None, "dolly")
    text, lifted = on_the_floor(path.read_text(), arm, str(path))
    out = tmp_path / "standing.urdf"
    out.write_text(text)
    return parse_urdf(out), lifted


def test_a_root_on_the_floor_stays(dolly, tmp_path):
    urdf, lifted = stand(dolly, tmp_path)
    assert (urdf.root, lifted) == ("base", 0.0)


@pytest.mark.parametrize(
    ("taken", "name"),
    [
        ({}, "base_footprint"),
        ({"head": "base_footprint"}, "footprint"),
        ({'name="mount"': 'name="base_footprint_joint"'}, "footprint"),
        ({"head": "base_footprint", '"tool"': '"footprint"'}, "footprint_2"),
        (
            {"head": "base_footprint", '"tool"': '"footprint"', '"mount"': '"footprint_2_joint"'},
            "footprint_3",
        ),
    ],
)
def test_a_root_above_the_floor_gets_one_below(changed, tmp_path, taken, name):
    above = ('origin xyz="0 0 0.2"', 'origin xyz="0 0 -0.1"')
    urdf, lifted = stand(changed(above, *taken.items()), tmp_path)
    assert (urdf.root, lifted) == (name, 0.3)
    down = np.array([0.0, 0.0, -1.0])
    lowest = max(one.reach(down) for one in place(urdf, urdf.links, urdf.root, {}))
    assert lowest == pytest.approx(0.0, abs=1e-9)
