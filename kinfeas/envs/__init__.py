"""The Markov decision process, its Gymnasium environments and episodes run in it.

May import backends and lower packages. Importing it registers the environments.
"""

from gymnasium.envs import registration

ENVIRONMENT = "kinfeas/BaseMotion-v0"
"""Gymnasium id of the environment without physics."""

PHYSICS_ENVIRONMENT = "kinfeas/BaseMotionPyBullet-v0"
"""Gymnasium id of the environment in PyBullet."""


def register() -> None:
    """Register the environments with Gymnasium; a second call changes nothing."""
    if ENVIRONMENT not in registration.registry:
        registration.register(
            ENVIRONMENT,
            entry_point="kinfeas.viz.gym:RenderedMotionEnv",
            vector_entry_point="kinfeas.envs.vector:BaseMotionVectorEnv",
        )
    if PHYSICS_ENVIRONMENT not in registration.registry:
        registration.register(
            PHYSICS_ENVIRONMENT,
            entry_point="kinfeas.envs.gym:BaseMotionEnv",
            vector_entry_point="kinfeas.envs.vector:BaseMotionVectorEnv",
            kwargs={"backend": "pybullet"},
        )


register()
