"""The arm follows the base: what becomes of a command within a control period."""

from kinfeas.control.drive import base_twist
from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolution, IkSolver


class KinematicStep:
    """Moves bases by commands and finds the arms that bring the EE to where it is to be.

    Attributes:
        solver: The robot's kinematics.
        dt: Control period in seconds.
        max_joint_step: How far each arm joint can go in a period, shape (j,), radians or metres.
    """

    def __init__(self, solver: IkSolver, dt: float) -> None:
        self.solver, self.dt = solver, dt
        self.max_joint_step: Array = solver.robot.max_joint_velocity * dt

    def __call__(
        self,
        action: Array,
        base_pose: Array,
        desired: Array,
        joints: Array,
        *,
        allow_reconfiguration: bool = True,
    ) -> tuple[Array, IkSolution]:
        """Return the world twists of the bases, shape (n, 6), and what IK finds for the arms.

        Args:
            action: Base commands in [-1, 1], shape (n, 3) or (n, 2).
            base_pose: World pose of the base, shape (n, 7).
            desired: World pose of the EE at the end of the period, shape (n, 7).
            joints: Arm joints that were last commanded, shape (n, j), radians or metres.
            allow_reconfiguration: Whether IK also looks for what the arm does not reach in time.
        """
        twist = base_twist(self.solver.robot.base, base_pose, action, self.dt)
        target = spatial.relative(desired, spatial.integrate(base_pose, twist, self.dt))
        return twist, self.solver.solve(
            target, joints, self.max_joint_step, allow_reconfiguration=allow_reconfiguration
        )
