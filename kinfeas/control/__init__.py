"""The control loop: motion sequence, observation, command filters and adapters.

One batched loop serves training, evaluation and deployment. Backends, envs and sim2real import it.
"""
