import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.tasks.loading import load_task, task_name

TASK = """
name: fetch
places: {cup: {position: [2, [-1, 1], 0.8]}}
subgoals: [{place: cup, frame: tip}]
"""


def test_by_name():
    assert load_task("ggr", {"orientation": "so3"}).name == "ggr"
    assert len(load_task("pick_place").subgoals) == 4


def test_by_path(tmp_path):
    path = tmp_path / "fetch.yaml"
    path.write_text(TASK)
    assert load_task(str(path)).name == "fetch"
    changed = load_task(str(path), {"places": {"cup": {"rpy": [0, 0, 1]}}, "name": "turned"})
    assert changed.name == "turned"
    assert changed.places["cup"].position == (2.0, (-1.0, 1.0), 0.8)
    assert changed.places["cup"].rpy == (0.0, 0.0, 1.0)


def test_what_it_is_called():
    names = ("ggr", "my.task", "my/fetch.yaml", "fetch.yml", "./fetch")
    assert [task_name(name) for name in names] == ["ggr", "my.task", "fetch", "fetch", "fetch"]


@pytest.mark.parametrize(
    ("name", "message"),
    [("fly", "unknown task 'fly'"), ("./fly.yaml", "fly.yaml: cannot be read")],
)
def test_unknown_tasks_are_one_sentence(name, message):
    with pytest.raises(KinfeasError, match=message):
        load_task(name)
