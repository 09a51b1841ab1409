"""From the analytic world to a robot: what goes between policy and backend."""
