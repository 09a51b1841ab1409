"""The analytic world: batched environment and Gymnasium environment; their ids."""

from gymnasium.envs import registration

ENVIRONMENT = "kinfeas/BaseMotion-v0"
"""What Gymnasium calls it."""

PHYSICS_ENVIRONMENT = "kinfeas/BaseMotionPyBullet-v0"
"""What it calls the one in the PyBullet world."""


def register() -> None:
    """Make `gymnasium.make` and `make_vec` know the environments; a second call changes nothing.

    Entry points are named, not imported: whoever wants another module of this package does not
    wait for the kernels.
    """
    if ENVIRONMENT not in registration.registry:
        registration.register(
            ENVIRONMENT,
            entry_point="kinfeas.viz.gym:RenderedMotionEnv",
            vector_entry_point="kinfeas.envs.vector:BaseMotionVectorEnv",
        )
    if PHYSICS_ENVIRONMENT not in registration.registry:
        registration.register(
            PHYSICS_ENVIRONMENT, entry_point="kinfeas.envs.physics_gym:PhysicsMotionEnv"
        )


register()
