"""The Markov decision process, its Gymnasium environments and episodes run in it.

May import backends and lower packages. Importing it registers the environments if Gymnasium is
installed.
"""

from importlib.util import find_spec

ENVIRONMENT = "kinfeas/BaseMotion-v0"
"""Gymnasium id of the environment without physics."""

PHYSICS_ENVIRONMENTS = {
    "pybullet": "kinfeas/BaseMotionPyBullet-v0",
    "mujoco": "kinfeas/BaseMotionMuJoCo-v0",
}
"""Gymnasium ids of the environments with physics, by backend."""


def register() -> None:
    """Register the environments with Gymnasium; a second call changes nothing."""
    from gymnasium.envs import registration

    for backend, name in {"analytic": ENVIRONMENT, **PHYSICS_ENVIRONMENTS}.items():
        if name not in registration.registry:
            registration.register(
                name,
                entry_point="kinfeas.viz.gym:BaseMotionEnv",
                vector_entry_point="kinfeas.envs.gym:BaseMotionVectorEnv",
                kwargs={"backend": backend},
            )


if find_spec("gymnasium"):
    register()
