from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation, wrap, yaw
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.tasks.chain import door, read_chain
from kinfeas.tasks.task import MotionSpec

SHIPPED = ("pick_place", "door", "drawer")


def build(name, **parameters):
    return registry.build("kinfeas.tasks", name, parameters)


def sample(task, solver, n=300):
    """Return base poses, joints and targets of n episodes."""
    episodes = [task.sample(solver, np.random.default_rng((0, i))) for i in range(n)]
    return (np.array([vars(one)[key] for one in episodes]) for key in vars(episodes[0]))


def uniform(values, low, high):
    """Return whether values look uniform; a share of 1e-4 of good draws would not."""
    return kstest(values, "uniform", args=(low, high - low)).pvalue > 1e-4


def write(tmp_path, text):
    path = tmp_path / "task.yaml"
    path.write_text(text)
    return path


def approach(targets):
    """Return the world directions along which the gripper comes, (n, 3)."""
    return rotation(targets).as_matrix()[:, :, 0]


@pytest.mark.parametrize("name", SHIPPED)
def test_starts(solver, name):
    task = build(name)
    base, joints, targets = sample(task, solver)
    assert task.name == name
    assert targets.shape == (300, len(task.subgoals), 7)
    assert uniform(base[:, 0], -0.75, 0.75)
    assert uniform(base[:, 1], -0.75, 0.75)
    way = targets[:, 0, :2] - base[:, :2]
    turn = wrap(yaw(base) - np.arctan2(way[:, 1], way[:, 0]))
    assert uniform(turn, -np.pi / 2, np.pi / 2)
    assert not self_collides(solver.collision, joints).any()
    assert forward(solver.chain, joints)[:, 2].std() > 0.1


def test_pick_place(exact_solver):
    """Objects on the near edge of a table at (3, 0), put down on that of another one."""
    task = build("pick_place")
    _, _, targets = sample(task, exact_solver)
    before, at, before_place, place = np.moveaxis(targets, 1, 0)
    assert [subgoal.dwell for subgoal in task.subgoals] == [0.0, 2.0, 0.0, 0.0]
    assert {(subgoal.frame, subgoal.motion.generator) for subgoal in task.subgoals} == {
        ("tip", "linear")
    }
    np.testing.assert_allclose(at[:, [0, 2]], np.tile([2.725, 0.61], (300, 1)))
    assert uniform(at[:, 1], -0.325, 0.325)
    np.testing.assert_allclose(at[:, :3] - before[:, :3], np.tile([0.2, 0, 0], (300, 1)))
    np.testing.assert_allclose(approach(at), np.tile([1.0, 0, 0], (300, 1)), atol=1e-12)
    assert uniform(place[:, 0], -1.5, 2.0)
    assert uniform(place[:, 1] - 0.275, -3.0, -2.5)
    np.testing.assert_allclose(place[:, 2], 0.70)
    np.testing.assert_allclose(
        place[:, :3] - before_place[:, :3], np.tile([0, -0.2, 0], (300, 1)), atol=1e-12
    )
    np.testing.assert_allclose(approach(place), np.tile([0, -1.0, 0], (300, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "handle", "along"),
    [("door", (-0.130, 2.796, 0.618), (0, 1, 0)), ("drawer", (-2.81, 0.015, 0.525), (-1, 0, 0))],
)
def test_furniture(exact_solver, name, handle, along):
    task = build(name)
    _, _, targets = sample(task, exact_solver, 5)
    np.testing.assert_allclose(targets[..., :3], np.broadcast_to(handle, (5, 2, 3)))
    np.testing.assert_allclose(approach(targets[:, 0]), np.tile(along, (5, 1)), atol=1e-12)
    assert [(subgoal.frame, subgoal.dwell) for subgoal in task.subgoals] == [
        ("tip", 2.0),
        ("tip", 0.0),
    ]
    models = [subgoal.motion.parameters["model"] for subgoal in task.subgoals]
    assert models == [f"{name}_grasp", f"{name}_open"]


@pytest.mark.parametrize("name", SHIPPED)
def test_same_seed_same_episode(solver, name):
    one, two = (build(name).sample(solver, np.random.default_rng(5)) for _ in range(2))
    for key, value in vars(one).items():
        np.testing.assert_array_equal(value, vars(two)[key])


def test_parameters_change_their_own_entries_only():
    task = build("pick_place", start={"square": 3.0}, places={"table": {"rpy": [0, 0, 3]}})
    plain = build("pick_place")
    assert task.start.square == 3.0
    assert task.start.heading == plain.start.heading
    assert task.places["object"] == plain.places["object"]
    assert task.places["table"].position == plain.places["table"].position


def test_parameters_change_one_leg():
    grasp, pull = door().subgoals
    motion = {"generator": "minimum_jerk", "parameters": {"max_velocity": 0.05}}
    changed = door(subgoals={"0": {"motion": motion}}).subgoals
    assert changed == (replace(grasp, motion=MotionSpec(**motion)), pull)
    slower = door(subgoals={"1": {"dwell": 3.0, "motion": {"parameters": {"gain": 0.5}}}}).subgoals
    parameters = {"model": "door_open", "gain": 0.5}
    assert slower == (grasp, replace(pull, dwell=3.0, motion=MotionSpec("imitation", parameters)))
    other = door(subgoals={"0": {"motion": {"generator": "linear"}}}).subgoals[0].motion
    assert other == MotionSpec("linear")
    with pytest.raises(KinfeasError, match=r"'2'"):
        door(subgoals={"2": {"dwell": 1.0}})


def test_least_that_a_file_needs(exact_solver, tmp_path):
    path = write(tmp_path, "{name: a, places: {b: {position: [1, 2, 3]}}, subgoals: [{place: b}]}")
    task = read_chain(path)
    (subgoal,) = task.subgoals
    assert (subgoal.frame, subgoal.dwell, subgoal.motion.generator) == ("ee", 0.0, "linear")
    target = task.sample(exact_solver, np.random.default_rng(0)).target_poses
    np.testing.assert_array_equal(target, [[1, 2, 3, 0, 0, 0, 1]])


def test_files_that_lie_beside_a_task_are_found_from_anywhere(tmp_path, monkeypatch):
    motion = "{generator: waypoints, parameters: {file: way.yaml}}"
    place = "a: {position: [1, 2, 3]}"
    scene = "{name: kitchen.yaml, success: {object: box, joint: lid}}"
    subgoals = f"[{{place: a, motion: {motion}}}]"
    text = f"{{name: b, places: {{{place}}}, subgoals: {subgoals}, scene: {scene}}}"
    path = write(tmp_path, text)
    (tmp_path / "way.yaml").touch()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    task = read_chain(path)
    assert task.subgoals[0].motion.parameters == {"file": str(tmp_path / "way.yaml")}
    assert task.scene.name == "kitchen.yaml"  # which does not: it is looked for from here
    changed = read_chain(path, {"scene": {"name": "way.yaml"}})
    assert changed.scene.name == "way.yaml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("subgoals: []", "'subgoals' must have at least one entry"),
        ("name: ''", "'name' must be printable, not empty and without '/', not ''"),
        ("name: a/b", "'name' must be printable, not empty and without '/', not 'a/b'"),
        ('name: "a\\tb"', "'name' must be printable"),
        ("subgoals: [{place: shelf}]", "'subgoals.0.place': unknown place 'shelf'; known are cup"),
        ("subgoals: [{place: cap}]", "did you mean 'cup'"),
        ("subgoals: [{offset: [0, 0, 1]}]", "'subgoals.0.place' is missing"),
        ("subgoals: [{place: cup, weight: 2}]", "unknown key 'subgoals.0.weight'"),
        (
            "subgoals: [{place: cup, dwell: -1}]",
            r"'subgoals.0.dwell'",
        ),
        (
            "subgoals: [{place: cup, dwell: 1e300}]",
            r"dwell'",
        ),
        (
            "subgoals: [{place: cup, offset: [0, 0, 1e300]}]",
            "'subgoals.0.offset.2'",
        ),
        ("places: {cup: {position: [1, 2, [-1e308, 1e308]]}}", "'places.cup.position.2' must be"),
        ("places: {cup: {position: [1, 2, 1e300]}}", "'places.cup.position.2'"),
        ("places: {cup: {position: [1, 2, 3], rpy: [0, 1e300, 0]}}", "'places.cup.rpy.1' must be"),
        ("start: {square: 1e300}", r"'start.square'"),
        ("subgoals: [{place: cup, frame: tool}]", "'subgoals.0.frame'"),
        (
            "subgoals: [{place: cup, offset: [1, 2]}]",
            "'subgoals.0.offset'",
        ),
        ("places: {cup: {position: [1, 2]}}", "'places.cup.position'"),
        ("places: {cup: {position: [1, 2, [3]]}}", "'places.cup.position.2' must be"),
        ("places: {cup: {position: [1, 2, [4, 3]]}}", "'position' must not descend from 4 to 3"),
        ("places: {cup: {position: [1, 2, 3], rpy: [0, [1, 0], 0]}}", "'rpy' must not descend"),
        ("start: {square: -1}", "'start.square'"),
        ("start: {heading: 4}", "'start.heading'"),
        ("start: {centre: 0}", "unknown key 'start.centre'"),
        ("colour: red", "unknown key 'colour'"),
    ],
)
def test_wrong_files_are_one_sentence(tmp_path, text, message):
    good = {
        "name": "name: fetch",
        "places": "places: {cup: {position: [1, 2, 3]}}",
        "subgoals": "subgoals: [{place: cup}]",
    }
    lines = {**good, text.split(":")[0]: text}
    path = write(tmp_path, "\n".join(lines.values()))
    with pytest.raises(KinfeasError, match=message) as caught:
        read_chain(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"colour": "red"}, "unknown key 'colour'"),
        ({"subgoals": []}, "'subgoals' must have at least one entry"),
        ({"start": {"square": -1}}, "'start.square'"),
    ],
)
def test_wrong_parameters_are_one_sentence_and_not_the_file_s_fault(name, parameters, message):
    with pytest.raises(KinfeasError, match=f"the task's parameters: {message}") as caught:
        build(name, **parameters)
    assert ".yaml" not in str(caught.value)


TWO_PLACES = """
name: tidy_up
places: {cup: {position: [2, 0, 0.8]}, bin: {position: [-1, 1, 0.5]}}
subgoals: [{place: cup}, {place: bin}]
"""


def test_a_misspelt_place_is_refused(tmp_path):
    path = write(tmp_path, TWO_PLACES)
    changes = {"places": {"cp": {"position": [1, 0, 0.8]}}}
    sentence = r"no sub-goal leads to 'cp' \(did you mean 'cup'\?\); known are bin, cup$"
    with pytest.raises(KinfeasError, match=f"^the task's parameters: 'places.cp': {sentence}"):
        read_chain(path, changes)
    path.write_text(TWO_PLACES.replace("cup: {pos", "cp: {position: [0, 0, 1]}, cup: {pos"))
    with pytest.raises(KinfeasError, match=f"task.yaml: 'places.cp': {sentence}"):
        read_chain(path)


def test_other_legs_may_leave_out_places_of_the_file(tmp_path):
    task = read_chain(write(tmp_path, TWO_PLACES), {"subgoals": [{"place": "bin"}]})
    assert [subgoal.place for subgoal in task.subgoals] == ["bin"]


def test_objects_stand_where_the_places_are(exact_solver):
    task = build("pick_place")
    for i in range(20):
        targets = task.sample(exact_solver, np.random.default_rng((1, i))).target_poses
        poses = task.object_poses(targets)
        assert poses.keys() == {"box", "place_table"}
        # The gripper's tip comes to rest within the box, and above the table.
        np.testing.assert_allclose(poses["box"][1:3], targets[1, 1:3] + [0.0, 0.025], atol=1e-9)
        assert 0.0 < poses["box"][0] - targets[1, 0] < 0.075
        way = targets[3, :3] - poses["place_table"][:3]
        assert np.all(np.abs(way[:2]) < 0.375)
        assert poses["place_table"][2] == pytest.approx(0.0, abs=1e-9)


def test_tasks_without_a_scene_move_nothing(tmp_path, exact_solver):
    path = write(
        tmp_path, "{name: a, places: {cup: {position: [1, 0, 1]}}, subgoals: [{place: cup}]}"
    )
    task = read_chain(path)
    targets = task.sample(exact_solver, np.random.default_rng(0)).target_poses
    assert task.object_poses(targets) == {}


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("{name: room}", "'scene.success' is missing"),
        ("{name: room, success: {object: box}}", "one of 'parent' and 'joint'"),
        (
            "{name: room, success: {object: box, parent: a, joint: b}}",
            "one of 'parent' and 'joint'",
        ),
        (
            "{name: room, success: {object: box, parent: a}, moves: {box: {place: tea}}}",
            "no sub-goal leads to 'tea'; known are cup",
        ),
    ],
)
def test_wrong_scenes_are_one_sentence(tmp_path, scene, message):
    text = "name: a\nplaces: {cup: {position: [1, 0, 1]}, tea: {position: [0, 1, 1]}}\n"
    path = write(tmp_path, f"{text}subgoals: [{{place: cup}}]\nscene: {scene}\n")
    with pytest.raises(KinfeasError, match=message):
        read_chain(path)
