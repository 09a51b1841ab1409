"""The baseline that plans: base and arm along paths, for any robot without training."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import ClassVar

from kinfeas.core.extras import EXTRAS
from kinfeas.core.policy import Observation, Policy
from kinfeas.core.spatial import Array
from kinfeas.policies.baselines.following import follow_ee
from kinfeas.policies.baselines.whole_body_qp import whole_body_qp
from kinfeas.robots.robot import Robot


@dataclass(frozen=True)
class Planner:
    """Acts as another policy, behind filters that plan the paths of known motions."""

    policy: Policy
    filters: ClassVar[tuple[str, ...]] = ("path_planner", "feasibility")

    def act(self, observation: Observation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        return self.policy.act(observation)


def planner(robot: Robot) -> Planner:
    """Return the baseline that drives along planned paths of base and arm.

    Where no path is found, it acts as `whole_body_qp`, without the extra `qp` as `follow_ee`.
    """
    with_qp = all(map(find_spec, EXTRAS["qp"]))
    return Planner(whole_body_qp(robot) if with_qp else follow_ee(robot))
