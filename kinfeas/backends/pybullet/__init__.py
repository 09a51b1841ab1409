"""The PyBullet world: robots, furniture and what holds between them, with physics."""
