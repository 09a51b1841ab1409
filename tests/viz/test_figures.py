import numpy as np

from kinfeas.scenes.scene import read_scene
from kinfeas.viz.figures import scene_figure
from kinfeas.viz.style import png


def test_a_scene_has_its_objects_and_the_paths_of_its_handles():
    room = read_scene("room")
    figure = scene_figure(room)
    (axes,) = figure.axes
    assert {text.get_text() for text in axes.texts} == set(room.objects) - {"walls"}
    paths = [line.get_data_3d() for line in axes.lines if len(line.get_data_3d()[0]) > 1]
    assert len(paths) == len(room.handles) == 2
    ends = {tuple(np.round([axis[0] for axis in path], 6)) for path in paths}
    assert ends == {tuple(np.round(room.handle_pose(name)[:3], 6)) for name in room.handles}
    assert png(figure, dpi=40).startswith(b"\x89PNG")
