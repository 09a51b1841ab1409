from dataclasses import replace

import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.backend import RobotState
from kinfeas.core.checks import are_unit, check_array, check_state, require_parameters
from kinfeas.core.errors import KinfeasError, check_name, is_own, plugin_note
from kinfeas.core.spatial import IDENTITY

SHAPE = (3, 6)
SOUND = RobotState(np.tile(IDENTITY, (3, 1)), np.zeros((3, 5)))


@pytest.mark.parametrize(
    "value",
    [
        np.zeros((3, 5)),
        np.zeros(SHAPE).tolist(),
        None,
        np.zeros(SHAPE).astype(str),
        np.zeros(SHAPE).astype(object),
        np.full(SHAPE, np.nan),
        np.full(SHAPE, np.inf),
    ],
)
def test_other_arrays_raise_errors(value):
    with pytest.raises(KinfeasError, match=r"^mine "):
        check_array(value, SHAPE, "mine")


@pytest.mark.parametrize("kind", [float, np.float32, int])
def test_numeric_arrays_pass(kind):
    check_array(np.full(SHAPE, 3, dtype=kind), SHAPE, "mine")
    check_array(np.full(SHAPE, np.nan), SHAPE, "mine", finite=False)


def test_unit_quaternions():
    assert are_unit(np.tile(IDENTITY, (2, 3, 1)))
    assert are_unit(np.empty((0, 7)))
    assert not are_unit(IDENTITY * 1.001)
    assert not are_unit(IDENTITY * np.nan)


STATES = {
    "state": lambda s: None,
    "base_pose": lambda s: replace(s, base_pose=s.base_pose[:2]),
    "joint_positions": lambda s: replace(s, joint_positions=s.joint_positions * np.nan),
    "ee_in_base": lambda s: replace(s, ee_in_base=np.zeros((3, 6))),
    "base_twist": lambda s: replace(s, base_twist=np.zeros((3, 7))),
    "age": lambda s: replace(s, age=0.1),
    "true_state": lambda s: replace(s, true_state=replace(s, base_pose=None)),
}


@pytest.mark.parametrize("name", STATES)
def test_other_states_raise_errors(name):
    check_state(replace(SOUND, age=np.full(3, np.nan), true_state=SOUND), 3, 5, "mine")
    with pytest.raises(KinfeasError, match="^mine.*" + ("RobotState" if name == "state" else name)):
        check_state(STATES[name](SOUND), 3, 5, "mine")


def test_measurements_of_robots_need_not_be_finite():
    lost = RobotState(SOUND.base_pose * np.nan, SOUND.joint_positions)
    check_state(lost, 3, 5, "mine", finite=False)
    with pytest.raises(KinfeasError, match="base_pose"):
        check_state(lost, 3, 5, "mine")


class Old:
    def twist(self, state, ee_pose, dt):
        pass


def test_methods_with_other_parameters_raise_errors():
    require_parameters(Old(), {"twist": ("state", "ee_pose", "dt"), "absent": ("x",)}, "mine")
    with pytest.raises(
        KinfeasError, match=r"^mine .*twist\(state, dt\), not twist\(state, ee_"
    ) as e:
        require_parameters(Old(), {"twist": ("state", "dt")}, "mine")
    assert isinstance(e.value, TypeError)


@pytest.mark.parametrize("error", [KeyError("x"), StopIteration(), KinfeasError("bad")])
def test_exceptions_keep_their_type_and_name_the_plugin(error):
    with pytest.raises(type(error)) as caught, plugin_note("adapter Mine"):
        raise error
    assert caught.value is error
    assert caught.value.__notes__ == ["raised by adapter Mine"]


def test_own_classes():
    assert is_own(AnalyticBackend())
    assert not is_own(Old())


@pytest.mark.parametrize("name", ["", " ", "a/b", "a\nb", "\x1b[31m"])
def test_names_that_do_not_fit_a_line(name):
    check_name("My robot-2")
    with pytest.raises(ValueError, match="'name'"):
        check_name(name)
