"""The analytic world: batched environment, Gymnasium environment, training adapter."""
