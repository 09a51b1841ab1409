"""The analytic world: batched environment, Gymnasium environment, training adapter."""

from gymnasium.envs import registration

ENVIRONMENT = "kinfeas/BaseMotion-v0"
"""What Gymnasium calls it."""


def register() -> None:
    """Make `gymnasium.make` and `make_vec` know the environment; a second call changes nothing.

    Entry points are named, not imported: whoever wants another module of this package does not
    wait for the kernels.
    """
    if ENVIRONMENT not in registration.registry:
        registration.register(
            ENVIRONMENT,
            entry_point="kinfeas.envs.gym:BaseMotionEnv",
            vector_entry_point="kinfeas.envs.vector:BaseMotionVectorEnv",
        )


register()
