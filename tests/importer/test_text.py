from dataclasses import fields, replace

import pytest

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core import registry
from kinfeas.importer.text import Guesses, robot_yaml
from kinfeas.robots.spec import PoseTolerance, RobotSpec

GRIPPER = ("left_finger_joint", "right_finger_joint")
SLIDES = frozenset({"torso_lift_joint", *GRIPPER})


@pytest.fixture
def spec():
    """A robot with a lift, a gripper that slides and a pose_tolerance."""
    path = registry.load("kinfeas.robots", "tiago")()
    known = config.load(RobotSpec, path)
    gripper = replace(known.gripper, fingers=GRIPPER)
    fixed, pose_tolerance = dict.fromkeys(GRIPPER, 0.02), PoseTolerance(0.1, 0.2)
    return replace(
        known,
        gripper=gripper,
        fixed_joints=fixed,
        pose_tolerance=pose_tolerance,
        ignored_collisions=(),
    )


def comments(text):
    """Return the comment behind each value, by its key."""
    lines = [line.partition("  # ") for line in text.splitlines() if "  # " in line]
    return {said.partition(":")[0].strip(): comment for said, _, comment in lines}


def test_every_number_has_its_unit(spec):
    text = robot_yaml(spec, Guesses(slides=SLIDES, fingers=2))
    said = comments(text)
    assert [said[entry.name] for entry in fields(spec.base)[1:]] == [
        "m/s",
        "rad/s",
        "m/s^2",
        "rad/s^2",
    ]
    assert (said["closed"], said["open"], said["effort"]) == ("m", "m", "N, the URDF's limit")
    assert said["left_finger_joint"] == said["position"] == said["ggr"] == "m"
    assert said["rotation"] == "rad"
    assert "# rad, or m where a joint slides\nhome:\n" in text


def test_fingers_that_turn_have_others(spec):
    text = robot_yaml(spec, Guesses(fingers=2))
    said = comments(text)
    assert (said["closed"], said["open"], said["effort"]) == ("rad", "rad", "N m, the URDF's limit")
    assert said["left_finger_joint"] == "rad"
    assert "# rad\nhome:\n" in text


def test_what_is_guessed_of_a_joint_has_the_unit_of_that(spec):
    joint, lift = "arm_1_joint", "torso_lift_joint"
    guessed = Guesses(speeds=(joint, lift), limits=(joint,), slides=SLIDES)
    said = comments(robot_yaml(spec, guessed))
    assert said[joint] == "rad, rad/s, guess"
    assert said[lift] == "m/s, guess"


@pytest.mark.parametrize(
    ("fingers", "tip", "turned"),
    [
        (0, "as far as the hand reaches", "no fingers; x away from the arm, y arbitrary"),
        (1, "as far as the hand reaches", "by how its jaw closes"),
        (2, "where the fingers end", "by where the fingers are"),
        (3, "where the fingers end", "by where the fingers are"),
    ],
)
def test_a_hand_is_told_by_the_fingers_that_were_found(spec, fingers, tip, turned):
    said = comments(robot_yaml(spec, Guesses(fingers=fingers)))
    assert said["tool_tip"] == f"m, guess: {tip}"
    assert said["gripper_rotation"] == f"x y z w, guess: {turned}"


def test_an_arm_that_may_have_no_base_is_told_of_in_a_line(spec):
    warning = "# Is link_0 a base that drives? It may be the arm's own first link.\nbase:\n"
    assert warning in robot_yaml(spec, Guesses(stand="link_0"))
    assert "own first link" not in robot_yaml(spec, Guesses())


@pytest.mark.parametrize("value", [1234.5678, 0.1 + 0.2, 1e-5, 12345678.0, 20.0])
def test_numbers_are_read_as_they_were(spec, value):
    fixed = {"finger": value}
    text = robot_yaml(replace(spec, fixed_joints=fixed), Guesses())
    assert config.from_mapping(RobotSpec, strict_yaml.parse(text, "it"), "it").fixed_joints == fixed


@pytest.mark.parametrize("stand", ["", "a: b", "two\nlines: 1"])
def test_comments_change_nothing(spec, stand):
    guesses = Guesses(slides=SLIDES, fingers=2, stand=stand)
    told = [
        config.from_mapping(RobotSpec, strict_yaml.parse(robot_yaml(spec, one), "it"), "it")
        for one in (Guesses(), guesses)
    ]
    assert told[0] == told[1]
